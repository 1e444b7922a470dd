//! Well-known text as a tree, for all dialects.
//!
//! WKT 1 (OGC 01-009), ESRI WKT and WKT 2 (OGC 18-010) share the grammar of keywords with bracketed
//! values.

/// A keyword with its values: `UNIT["metre",1]`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WktNode {
    /// Keyword, in capitals.
    pub keyword: String,
    /// Values in its brackets.
    pub values: Vec<WktValue>,
}

/// A value in the brackets of a keyword.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum WktValue {
    /// Quoted text, without the quotation marks.
    Text(String),
    /// A number or a bare word, as written.
    Bare(String),
    /// A keyword with values.
    Node(WktNode),
}

/// Depth limit, which protects the stack; text in use is nested up to 12 deep.
const DEEPEST: usize = 32;

impl WktNode {
    /// Parses text that is one keyword with its values.
    ///
    /// A horizontal and a vertical system with a comma between them, as ESRI writes them, become a
    /// compound system.
    ///
    /// # Errors
    /// The problem and the character position, as the end of a sentence.
    pub(crate) fn parse(text: &str) -> Result<WktNode, String> {
        let mut reader = WktReader { text: text.trim_start_matches('\u{feff}'), at: 0 };
        let mut node = reader.node(0)?;
        if reader.eat(&[',']) {
            let vertical = reader.node(0)?;
            if vertical.keyword != "VERTCS" {
                return Err(reader.problem("the second system is not a vertical one (VERTCS)"));
            }
            node = compound(node, vertical);
        }
        reader.blanks();
        match reader.peek() {
            None | Some('\0') => Ok(node),
            Some(_) => Err(reader.problem("unexpected text after the last bracket")),
        }
    }

    /// A node whose first value is a name.
    pub(crate) fn named(keyword: &str, name: &str) -> WktNode {
        WktNode { keyword: keyword.into(), values: vec![WktValue::Text(name.into())] }
    }

    /// Appends a number.
    pub(crate) fn number(mut self, number: f64) -> WktNode {
        self.values.push(WktValue::Bare(number.to_string()));
        self
    }

    /// Appends a bare word.
    pub(crate) fn bare(mut self, word: &str) -> WktNode {
        self.values.push(WktValue::Bare(word.into()));
        self
    }

    /// Appends a node.
    pub(crate) fn with(mut self, node: WktNode) -> WktNode {
        self.values.push(WktValue::Node(node));
        self
    }

    /// The first value, if it is text.
    pub(crate) fn name(&self) -> Option<&str> {
        self.text(0)
    }

    /// A text value by index from 0.
    pub(crate) fn text(&self, place: usize) -> Option<&str> {
        match self.values.get(place)? {
            WktValue::Text(text) => Some(text),
            _ => None,
        }
    }

    /// A numeric value by index from 0.
    pub(crate) fn value(&self, place: usize) -> Option<f64> {
        match self.values.get(place)? {
            WktValue::Bare(number) | WktValue::Text(number) => {
                number.parse().ok().filter(|n: &f64| n.is_finite())
            }
            WktValue::Node(_) => None,
        }
    }

    /// The nodes among the values.
    pub(crate) fn nodes(&self) -> impl Iterator<Item = &WktNode> {
        self.values.iter().filter_map(|value| match value {
            WktValue::Node(node) => Some(node),
            _ => None,
        })
    }

    /// The nodes among the values, mutable.
    pub(crate) fn nodes_mut(&mut self) -> impl Iterator<Item = &mut WktNode> {
        self.values.iter_mut().filter_map(|value| match value {
            WktValue::Node(node) => Some(node),
            _ => None,
        })
    }

    /// The first child node with one of these keywords.
    pub(crate) fn child(&self, keywords: &[&str]) -> Option<&WktNode> {
        self.nodes().find(|node| keywords.contains(&node.keyword.as_str()))
    }

    /// The first node with one of these keywords, here or below, depth first.
    pub(crate) fn find(&self, keywords: &[&str]) -> Option<&WktNode> {
        if keywords.contains(&self.keyword.as_str()) {
            return Some(self);
        }
        self.nodes().find_map(|node| node.find(keywords))
    }

    /// Removes the nodes for which `unwanted` holds, here and below.
    pub(crate) fn remove(&mut self, unwanted: &impl Fn(&WktNode) -> bool) {
        self.values.retain(|value| !matches!(value, WktValue::Node(node) if unwanted(node)));
        self.nodes_mut().for_each(|node| node.remove(unwanted));
    }

    /// EPSG code of this node, from `AUTHORITY["EPSG","2154"]` or `ID["EPSG",2154]`.
    pub(crate) fn epsg(&self) -> Option<u32> {
        let authority = self.child(&["AUTHORITY", "ID"])?;
        let code = match authority.values.get(1)? {
            WktValue::Text(code) | WktValue::Bare(code) => code.parse().ok()?,
            WktValue::Node(_) => return None,
        };
        authority.name()?.eq_ignore_ascii_case("EPSG").then_some(code)
    }

    /// Appends an EPSG code.
    pub(crate) fn authority(self, epsg: Option<u32>) -> WktNode {
        let Some(code) = epsg else { return self };
        let mut authority = WktNode::named("AUTHORITY", "EPSG");
        authority.values.push(WktValue::Text(code.to_string()));
        self.with(authority)
    }
}

/// Formats the tree on one line.
impl std::fmt::Display for WktNode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}[", self.keyword)?;
        for (place, value) in self.values.iter().enumerate() {
            if place > 0 {
                f.write_str(",")?;
            }
            match value {
                WktValue::Text(text) => write!(f, "\"{}\"", text.replace('"', "\"\""))?,
                WktValue::Bare(word) => f.write_str(word)?,
                WktValue::Node(node) => write!(f, "{node}")?,
            }
        }
        f.write_str("]")
    }
}

/// A position in the text.
struct WktReader<'a> {
    text: &'a str,
    at: usize,
}

impl WktReader<'_> {
    fn rest(&self) -> &str {
        self.text.get(self.at..).unwrap_or_default()
    }

    fn peek(&self) -> Option<char> {
        self.rest().chars().next()
    }

    fn blanks(&mut self) {
        let rest = self.rest();
        self.at += rest.len() - rest.trim_start().len();
    }

    /// Skips blanks and then one of these characters, if present.
    fn eat(&mut self, wanted: &[char]) -> bool {
        self.blanks();
        let found = self.peek().filter(|c| wanted.contains(c));
        self.at += found.map_or(0, char::len_utf8);
        found.is_some()
    }

    /// Reads letters, digits and characters of numbers.
    fn word(&mut self) -> String {
        self.blanks();
        let is_word = |c: char| c.is_alphanumeric() || "_+-.:".contains(c);
        let word: String = self.rest().chars().take_while(|c| is_word(*c)).collect();
        self.at += word.len();
        word
    }

    fn node(&mut self, depth: usize) -> Result<WktNode, String> {
        let keyword = self.word();
        if keyword.is_empty() {
            return Err(self.problem("a keyword is expected"));
        }
        if !self.eat(&['[', '(']) {
            return Err(self.problem("a bracket is expected"));
        }
        self.values(keyword, depth)
    }

    /// Reads the values after the opening bracket of a keyword.
    fn values(&mut self, keyword: String, depth: usize) -> Result<WktNode, String> {
        if depth > DEEPEST {
            return Err(self.problem("it is nested too deeply"));
        }
        let mut values = Vec::new();
        loop {
            values.push(self.one_value(depth)?);
            if self.eat(&[']', ')']) {
                return Ok(WktNode { keyword: keyword.to_uppercase(), values });
            }
            if !self.eat(&[',']) {
                return Err(self.problem("a comma or a closing bracket is expected"));
            }
        }
    }

    fn one_value(&mut self, depth: usize) -> Result<WktValue, String> {
        if self.eat(&['"']) {
            return self.quoted().map(WktValue::Text);
        }
        let word = self.word();
        match (word.is_empty(), self.eat(&['[', '('])) {
            (true, _) => Err(self.problem("a value is expected")),
            (false, true) => self.values(word, depth + 1).map(WktValue::Node),
            (false, false) => Ok(WktValue::Bare(word)),
        }
    }

    /// Reads text up to the closing quotation mark; two marks mean one.
    fn quoted(&mut self) -> Result<String, String> {
        let mut text = String::new();
        loop {
            let Some(end) = self.rest().find('"') else {
                return Err(self.problem("a closing quotation mark is missing"));
            };
            text.extend(self.rest().get(..end));
            self.at += end + 1;
            if self.peek() != Some('"') {
                return Ok(text);
            }
            text.push('"');
            self.at += 1;
        }
    }

    fn problem(&self, what: &str) -> String {
        let read = self.text.get(..self.at).unwrap_or(self.text);
        format!("{what} at character {}", read.chars().count() + 1)
    }
}

/// A compound CRS with the names of its parts.
pub(super) fn compound(horizontal: WktNode, vertical: WktNode) -> WktNode {
    let names = [&horizontal, &vertical].map(|part| part.name().unwrap_or_default().to_string());
    WktNode::named("COMPD_CS", &names.join(" + ")).with(horizontal).with(vertical)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn wkt_round_trips() {
        let text = r#"GEOGCS["a ""b""",PRIMEM["Greenwich",0],AXIS["Lon",EAST],AUTHORITY["EPSG","4326"]]"#;
        let node = WktNode::parse(text).unwrap();
        assert_eq!(node.name(), Some("a \"b\""));
        assert_eq!(node.child(&["PRIMEM"]).unwrap().value(1), Some(0.0));
        assert_eq!(node.epsg(), Some(4326));
        assert_eq!(node.to_string(), text);
        let spaced = " \u{feff}geogcs ( \"a \"\"b\"\"\" ,\n PRIMEM[\"Greenwich\", 0 ], AXIS[\"Lon\",EAST] ,AUTHORITY[\"EPSG\",\"4326\"])\0";
        assert_eq!(WktNode::parse(spaced.trim_start()).unwrap(), node);
        assert_eq!(WktNode::parse(r#"A["x",ID["EPSG",7]]"#).unwrap().epsg(), Some(7));
    }

    #[test]
    fn errors_name_the_character() {
        let deep = "A[".repeat(100_000);
        for (text, problem) in [
            ("", "a keyword is expected at character 1"),
            ("PROJCS", "a bracket is expected at character 7"),
            (r#"A["x"#, "a closing quotation mark is missing at character 4"),
            (r#"A["x""#, "a comma or a closing bracket is expected at character 6"),
            (r#"A["ä",]"#, "a value is expected at character 7"),
            (r#"A["x"] B"#, "unexpected text after the last bracket at character 8"),
            (&deep, "it is nested too deeply at character 69"),
        ] {
            assert_eq!(WktNode::parse(text).unwrap_err(), problem);
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_tree_or_an_error(text in "[A-C\\[\\]\\(\\)\",.0-9äö \\n]{0,60}") {
            if let Ok(node) = WktNode::parse(&text) {
                prop_assert_eq!(WktNode::parse(&node.to_string()).unwrap(), node);
            }
        }
    }
}
