//! Times as vendors write them. A date without a time is refused: the sun moves 15 degrees an hour.

use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// UTC time of a text: RFC 3339 with or without a zone (UTC then), with a blank for the `T`, with `GMT` or `UTC` behind
/// it, `YYYYMMDDhhmmss`, or NITF 2.0's `DDhhmmssZMONYY`.
pub(super) fn utc(text: &str) -> Option<Timestamp> {
    let text = text.trim().trim_end_matches(';').trim_matches('"').trim();
    if !text.is_ascii() {
        return None;
    }
    if let Some(compact) = compact(text).or_else(|| nitf_2_0(text)) {
        return utc_of_civil(&compact);
    }
    if !text.contains(':') {
        return None;
    }
    if let Ok(time) = text.parse::<Timestamp>() {
        return Some(time);
    }
    let bare = ["GMT", "UTC", "Z", "z"]
        .iter()
        .find_map(|zone| text.strip_suffix(zone))
        .unwrap_or(text);
    utc_of_civil(bare.trim_end())
}

/// UTC time of a date and a time in two values, as in DIMAP.
pub(super) fn utc_of_date_and_time((date, time): (&str, &str)) -> Option<Timestamp> {
    utc(&format!("{}T{}", date.trim(), time.trim()))
}

fn utc_of_civil(text: &str) -> Option<Timestamp> {
    let civil: DateTime = text.parse().ok()?;
    TimeZone::UTC.to_timestamp(civil).ok()
}

/// `YYYYMMDDhhmmss`, perhaps with a fraction.
fn compact(text: &str) -> Option<String> {
    let (digits, fraction) = text.split_at_checked(14)?;
    let fraction_ok = fraction.is_empty()
        || fraction
            .strip_prefix('.')
            .is_some_and(|f| !f.is_empty() && f.bytes().all(|b| b.is_ascii_digit()));
    if !fraction_ok || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    // Nine digits of a second are all that a timestamp holds.
    let fraction = fraction.get(..10).unwrap_or(fraction);
    Some(format!(
        "{}-{}-{}T{}:{}:{}{fraction}",
        &digits[..4],
        &digits[4..6],
        &digits[6..8],
        &digits[8..10],
        &digits[10..12],
        &digits[12..14]
    ))
}

/// `DDhhmmssZMONYY`.
fn nitf_2_0(text: &str) -> Option<String> {
    if text.len() != 14 || &text[8..9] != "Z" || !text[..8].bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let month = month_of(&text[9..12])?;
    let year: u32 = text[12..].parse().ok()?;
    // No reconnaissance image is older than the sixties.
    let year = if year < 60 { 2000 + year } else { 1900 + year };
    Some(format!(
        "{year}-{month:02}-{}T{}:{}:{}",
        &text[..2],
        &text[2..4],
        &text[4..6],
        &text[6..8]
    ))
}

/// Number of a month, from 1, of its first three letters in English.
pub(super) fn month_of(name: &str) -> Option<usize> {
    const MONTHS: [&str; 12] = [
        "JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC",
    ];
    Some(MONTHS.iter().position(|month| name.eq_ignore_ascii_case(month))? + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_to_write_a_time_is_the_same_time() {
        let expected: Timestamp = "2012-06-01T14:00:00Z".parse().expect("RFC 3339");
        for text in [
            "2012-06-01T14:00:00.000000Z",
            "2012-06-01T14:00:00Z;",
            "2012-06-01T14:00:00",
            "2012-06-01 14:00:00",
            "2012-06-01 14:00 GMT",
            "2012-06-01T16:00:00+02:00",
            "\"2012-06-01T14:00:00Z\"",
            "20120601140000",
            "20120601140000.000000",
            "01140000ZJUN12",
        ] {
            assert_eq!(utc(text), Some(expected), "{text}");
        }
        assert_eq!(utc_of_date_and_time(("2012-06-01", "14:00:00.0Z")), Some(expected));
    }

    #[test]
    fn a_date_alone_or_nonsense_is_no_time() {
        for text in [
            "",
            "2012-06-01",
            "20120601",
            "2012-13-01T14:00:00Z",
            "--------------",
            "99999999999999",
            "IMAGING_TIME",
            "20120601140000.",
            "12:00",
            "é2012-06-01T14:00:00",
        ] {
            assert_eq!(utc(text), None, "{text}");
        }
    }
}
