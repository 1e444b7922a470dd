//! A minimal SVG writer.

use std::fmt::Write;

/// A picture built element by element; the style sheet's classes define the looks.
pub struct Svg {
    body: String,
}

/// Text anchor relative to its position.
#[derive(Clone, Copy)]
pub enum Anchor {
    /// The text starts at the position.
    Start,
    /// The text is centred at the position.
    Middle,
    /// The text ends at the position.
    End,
}

impl Anchor {
    fn name(self) -> &'static str {
        match self {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        }
    }
}

/// Style sheet: follows the system's light or dark theme; colours also differ in lightness.
const STYLE: &str = "\
text{font-family:'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',Arial,sans-serif;font-size:12px;fill:#333}
.page{fill:#ffffff}.title{font-size:17px;font-weight:600;fill:#111}.note{fill:#666}.num{font-weight:600;fill:#111}
.frame{fill:none;stroke:#888}.grid{stroke:#e4e4e4}.zero{stroke:#999}
.sample{fill:#1a1a1a}.left{fill:#fff;stroke:#1a1a1a}.sat{fill:#fff;stroke:#c22020;stroke-width:1.5}
.fit{fill:none;stroke:#1565c0;stroke-width:2}.level{stroke:#777;stroke-dasharray:5 4}
.pulse{fill:none;stroke:#e07b00;stroke-width:1.2}.peak{stroke:#e07b00;stroke-dasharray:2 3}
.one{fill:#1565c0;fill-opacity:.13}.limit{stroke:#c22020;stroke-dasharray:6 4}.stem{stroke:#9a9a9a}
@media (prefers-color-scheme:dark){
text{fill:#ccc}.page{fill:#16181c}.title,.num{fill:#f2f2f2}.note{fill:#999}
.frame{stroke:#777}.grid{stroke:#2b2f36}.zero{stroke:#777}
.sample{fill:#eee}.left{fill:#16181c;stroke:#eee}.sat{fill:#16181c;stroke:#ff6b6b}
.fit{stroke:#64b5f6}.level{stroke:#999}.pulse{stroke:#ffb74d}.peak{stroke:#ffb74d}
.one{fill:#64b5f6;fill-opacity:.18}.limit{stroke:#ff6b6b}.stem{stroke:#777}}
";

impl Default for Svg {
    fn default() -> Svg {
        Svg::new()
    }
}

impl Svg {
    /// An empty picture.
    pub fn new() -> Svg {
        Svg { body: String::new() }
    }

    /// Returns the complete document.
    pub fn finish(self, width: f64, height: f64, title: &str) -> String {
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" role=\"img\">\n<title>{}</title>\n<style>\n{STYLE}</style>\n\
             <rect class=\"page\" width=\"{width}\" height=\"{height}\"/>\n{}</svg>\n",
            escaped(title),
            self.body
        )
    }

    /// Returns the picture as an element of a page that has its own style sheet.
    pub(crate) fn inline(self, width: f64, height: f64, title: &str) -> String {
        let (title, body) = (escaped(title), self.body);
        format!(
            "<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{title}\">\n<title>{title}</title>\n{body}</svg>\n"
        )
    }

    /// Draws a straight line between two points.
    pub fn line(&mut self, class: &str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) {
        let _ = writeln!(
            self.body,
            "<line class=\"{class}\" x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\"/>"
        );
    }

    /// Draws a rectangle from its upper left to its lower right corner.
    pub fn rect(&mut self, class: &str, corner: [f64; 2], other: [f64; 2]) {
        let _ = writeln!(self.body, "<rect class=\"{class}\" {}/>", within(corner, other));
    }

    /// Draws a rectangle of this colour, for legends.
    pub(crate) fn swatch(&mut self, colour: &str, corner: [f64; 2], other: [f64; 2]) {
        let _ = writeln!(self.body, "<rect fill=\"{colour}\" {}/>", within(corner, other));
    }

    /// Embeds a raster image from its upper left to its lower right corner.
    pub(crate) fn image(&mut self, id: &str, url: &str, corner: [f64; 2], other: [f64; 2]) {
        let place = within(corner, other);
        let _ =
            writeln!(self.body, "<image id=\"{id}\" href=\"{url}\" {place} preserveAspectRatio=\"none\"/>");
    }

    /// Repeats an element of the same page at the same position.
    pub(crate) fn again(&mut self, class: &str, id: &str) {
        let _ = writeln!(self.body, "<use class=\"{class}\" href=\"#{id}\"/>");
    }

    /// Draws a circle around a point.
    pub fn circle(&mut self, class: &str, [x, y]: [f64; 2], radius: f64) {
        let _ = writeln!(self.body, "<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\"/>");
    }

    /// Draws straight lines from point to point; nothing if there are fewer than two.
    pub fn curve(&mut self, class: &str, points: impl Iterator<Item = [f64; 2]>) {
        let points = list(points);
        if points.contains(' ') {
            let _ = writeln!(self.body, "<polyline class=\"{class}\" points=\"{points}\"/>");
        }
    }

    /// Draws a filled polygon with these corners.
    pub(crate) fn area(&mut self, class: &str, corners: impl Iterator<Item = [f64; 2]>) {
        let _ = writeln!(self.body, "<polygon class=\"{class}\" points=\"{}\"/>", list(corners));
    }

    /// Writes text at a position.
    pub fn text(&mut self, class: &str, at: [f64; 2], anchor: Anchor, text: &str) {
        self.place_text(class, at, anchor, "", text);
    }

    /// Draws text rotated by 90 degrees, centred at a position.
    pub fn upright_text(&mut self, class: &str, [x, y]: [f64; 2], text: &str) {
        let turn = format!(" transform=\"rotate(-90 {x:.1} {y:.1})\"");
        self.place_text(class, [x, y], Anchor::Middle, &turn, text);
    }

    fn place_text(&mut self, class: &str, [x, y]: [f64; 2], anchor: Anchor, turn: &str, text: &str) {
        let (anchor, text) = (anchor.name(), escaped(text));
        let _ = writeln!(
            self.body,
            "<text class=\"{class}\" x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\"{turn}>{text}</text>"
        );
    }
}

/// Position and size of an element from its upper left to its lower right corner.
fn within([left, top]: [f64; 2], [right, bottom]: [f64; 2]) -> String {
    let (width, height) = ((right - left).max(0.0), (bottom - top).max(0.0));
    format!("x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\"")
}

/// Coordinates of points.
fn list(points: impl Iterator<Item = [f64; 2]>) -> String {
    points.map(|[x, y]| format!("{x:.1},{y:.1}")).collect::<Vec<String>>().join(" ")
}

/// Escapes text for XML.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            // XML does not allow other control characters.
            character if character.is_control() => safe.push(' '),
            character => safe.push(character),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_xml_reserves_is_escaped() {
        assert_eq!(escaped("a<b> & \"c\"\u{1}"), "a&lt;b&gt; &amp; &quot;c&quot; ");
    }
}
