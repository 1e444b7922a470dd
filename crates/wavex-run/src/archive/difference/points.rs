//! First difference of two LAS or LAZ files: point and field, header field, or VLR.

use std::path::Path;

use super::instead;
use wavex_formats::Result;
use wavex_formats::las::{RawField, RawPoints};

pub(super) fn compare(then: &Path, now: &Path) -> Result<Option<String>> {
    let (mut a, mut b) = (RawPoints::open(then)?, RawPoints::open(now)?);
    if a.fields() != b.fields() {
        let names = |points: &RawPoints| {
            let fields = points.fields().iter().map(|field| field.name.as_str());
            format!("the fields {}", fields.collect::<Vec<_>>().join(", "))
        };
        return Ok(Some(format!("its points have {}", instead(&names(&b), &names(&a)))));
    }
    // Compare points first: counts and bounds in the header follow from them.
    match compare_points(&mut a, &mut b)? {
        None => Ok(compare_headers(&a, &b)),
        found => Ok(found),
    }
}

fn compare_points(a: &mut RawPoints, b: &mut RawPoints) -> Result<Option<String>> {
    let fields: Vec<RawField> = a.fields().to_vec();
    let mut number = 0u64;
    loop {
        match (a.next_record()?, b.next_record()?) {
            (None, None) => return Ok(None),
            (Some(_), None) => return Ok(Some(format!("it ends before point {number}"))),
            (None, Some(_)) => return Ok(Some(format!("it continues with point {number}"))),
            (Some(then), Some(now)) if then != now => {
                let differs = |field: &&RawField| field.value(then) != field.value(now);
                let found = fields.iter().find(differs).map(|field| {
                    let values = instead(&field.value(now), &field.value(then));
                    format!("point {number}, field {}: {values}", field.name)
                });
                return Ok(Some(found.unwrap_or_else(|| format!("point {number}"))));
            }
            _ => number += 1,
        }
    }
}

fn compare_headers(a: &RawPoints, b: &RawPoints) -> Option<String> {
    let lines = |points: &RawPoints| -> Vec<String> {
        let header = format!("{:#?}", points.header());
        header.lines().map(|line| line.trim().trim_end_matches(',').to_owned()).collect()
    };
    let (then, now) = (lines(a), lines(b));
    let mut name = String::new();
    for (then, now) in then.iter().zip(&now) {
        if let Some((key, _)) = now.split_once(": ") {
            key.clone_into(&mut name);
        }
        if then != now {
            let value =
                |line: &str| line.split_once(": ").map_or(line.to_owned(), |(_, value)| value.to_owned());
            return Some(format!(
                "header, {}: {}",
                name.replace('_', " "),
                instead(&value(now), &value(then))
            ));
        }
    }
    let mut records = a.vlrs().iter().zip(b.vlrs());
    let (then, _) = records.find(|(then, now)| then != now)?;
    Some(format!("the record {}/{} of the header", then.user_id, then.record_id))
}
