//! Numbers as text, for pages and verdicts.

/// Axis label; groups thousands from five digits on.
pub(crate) fn label(value: f64, digits: usize) -> String {
    let text = format!("{:.digits$}", value.abs());
    let is_zero = text.chars().all(|character| matches!(character, '0' | '.'));
    let (whole, rest) =
        text.split_once('.').map_or((text.as_str(), None), |(whole, rest)| (whole, Some(rest)));
    let mut grouped = String::new();
    for (i, digit) in whole.chars().enumerate() {
        if whole.len() > 4 && i > 0 && (whole.len() - i).is_multiple_of(3) {
            grouped.push('\u{202f}');
        }
        grouped.push(digit);
    }
    let sign = if value < 0.0 && !is_zero { "−" } else { "" };
    rest.map_or_else(|| format!("{sign}{grouped}"), |rest| format!("{sign}{grouped}.{rest}"))
}

/// A number with its unit; degrees follow without a space.
pub(crate) fn with_unit(text: &str, unit: &str) -> String {
    match unit {
        "" => text.to_owned(),
        "°" => format!("{text}°"),
        unit => format!("{text} {unit}"),
    }
}

/// Formats a value with about three significant digits.
pub(crate) fn short(value: f64) -> String {
    let size = value.abs().max(1e-12).log10().floor();
    let digits = (2.0 - size).clamp(0.0, 6.0) as usize;
    let text = label(value, digits);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_grouped_and_digits_are_few() {
        assert_eq!([label(-0.0, 0), label(-0.04, 1)], ["0", "0.0"]);
        assert_eq!(label(5_338_200.0, 0), "5\u{202f}338\u{202f}200");
        assert_eq!(label(-1234.5, 1), "−1234.5");
        assert_eq!([short(0.012_345), short(1.0), short(123.46), short(0.0)], ["0.0123", "1", "123", "0"]);
    }
}
