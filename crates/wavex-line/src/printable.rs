//! Replacement of characters that would act on a terminal or a page instead of being shown.

use std::borrow::Cow;

/// Replaces control characters and changes of text direction, except line feeds and tabs.
///
/// Texts of files, such as names of coordinate reference systems, can contain them.
pub fn printable(text: &str) -> Cow<'_, str> {
    let is_harmful = |character: char| match character {
        '\n' | '\t' => false,
        '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => true,
        character => character.is_control(),
    };
    if text.contains(is_harmful) { text.replace(is_harmful, "\u{fffd}").into() } else { text.into() }
}

#[cfg(test)]
mod tests {
    use super::printable;

    #[test]
    fn control_characters_and_changes_of_direction_are_replaced() {
        assert_eq!(printable("é\ta\n"), "é\ta\n");
        assert_eq!(
            printable("a\x1b[31mb\x1b]0;c\x07\r\0\u{9b}2J\u{202e}d"),
            "a\u{fffd}[31mb\u{fffd}]0;c\u{fffd}\u{fffd}\u{fffd}\u{fffd}2J\u{fffd}d"
        );
    }
}
