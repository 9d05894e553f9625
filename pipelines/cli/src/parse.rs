//! Parsers of argument values, with messages that state the expected form.

pub use heliosplat_batch::manifest::bytes;
use heliosplat_rpc::sun::SunPosition;
use heliosplat_scene::AreaRequest;
use std::time::Duration;

/// Parses `A,B`: two finite numbers.
///
/// # Errors
/// Message for the user with the expected form.
pub fn pair(text: &str) -> Result<[f64; 2], String> {
    let numbers = numbers(text)?;
    <[f64; 2]>::try_from(numbers).map_err(|_| "expected two numbers, as in 10,20".to_owned())
}

/// Parses `AZ,EL`: azimuth and elevation of a sun, degrees.
///
/// # Errors
/// Message for the user with the expected form or range.
pub fn sun(text: &str) -> Result<SunPosition, String> {
    let [azimuth, elevation] = pair(text)?;
    SunPosition::stated(azimuth, elevation)
}

/// Parses `WEST,SOUTH,EAST,NORTH` in degrees, or with a final `,EPSG:N` in units of that system.
///
/// # Errors
/// Message for the user with the expected form or order.
pub fn area(text: &str) -> Result<AreaRequest, String> {
    let (bounds, crs) = match text.split_once(",EPSG:") {
        Some((bounds, number)) => (bounds, Some(format!("EPSG:{}", number.trim()))),
        None => (text, None),
    };
    let bounds = <[f64; 4]>::try_from(numbers(bounds)?)
        .map_err(|_| "expected WEST,SOUTH,EAST,NORTH, as in 36.90,37.58,36.91,37.59".to_owned())?;
    let area = AreaRequest { bounds, crs };
    area.check()?;
    Ok(area)
}

/// Parses `A,B,C`: three finite numbers.
///
/// # Errors
/// Message for the user with the expected form.
pub fn triple(text: &str) -> Result<[f64; 3], String> {
    let numbers = numbers(text)?;
    <[f64; 3]>::try_from(numbers).map_err(|_| "expected three numbers, as in 1,2,3".to_owned())
}

/// Parses finite numbers separated by commas.
///
/// # Errors
/// Message for the user with the faulty word.
pub fn numbers(text: &str) -> Result<Vec<f64>, String> {
    let number = |word: &str| {
        let value: f64 = word.trim().parse().map_err(|_| format!("'{word}' is not a number"))?;
        let finite = Some(value).filter(|value| value.is_finite());
        finite.ok_or_else(|| format!("'{word}' is not a finite number"))
    };
    text.split(',').map(number).collect()
}

/// Parses a duration such as `90s`, `5m`, `1h30m` or `1.5h`; a bare number is seconds.
///
/// # Errors
/// Message for the user with the expected form; durations below zero are refused.
pub fn duration(text: &str) -> Result<Duration, String> {
    let expected = |_| "expected a time such as 90s, 5m or 1h30m".to_owned();
    let negative = "expected a time that is not negative".to_owned();
    if let Ok(seconds) = text.trim().parse::<f64>() {
        return Duration::try_from_secs_f64(seconds).map_err(|_| negative);
    }
    let duration: jiff::SignedDuration = text.trim().parse().map_err(expected)?;
    Duration::try_from(duration).map_err(|_| negative)
}

/// Parses `key=value`, and removes spaces around both; the key must not be empty.
///
/// # Errors
/// Message for the user with the expected form.
pub fn key_value(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((key, value)) if !key.trim().is_empty() => Ok((key.trim().to_owned(), value.trim().to_owned())),
        _ => Err("expected key=value".to_owned()),
    }
}

/// Parses a time in RFC 3339.
///
/// # Errors
/// Message for the user with the expected form.
pub fn time(text: &str) -> Result<jiff::Timestamp, String> {
    let wrong = |_| "expected a time such as 2016-04-23T08:34:00Z".to_owned();
    text.parse().map_err(wrong)
}

/// Parses a date such as `2026-06-21`.
///
/// # Errors
/// Message for the user with the expected form.
pub fn date(word: &str) -> Result<jiff::civil::Date, String> {
    let wrong = |_| format!("'{word}' is not a date such as 2026-06-21");
    word.trim().parse().map_err(wrong)
}

/// Parses a finite number above zero.
///
/// # Errors
/// Message for the user with the expected range.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("expected a number above 0".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_area_has_a_west_before_its_east_and_maybe_a_system() {
        let area_of = area("36.9,37.5,37.0,37.6").expect("degrees");
        assert_eq!((area_of.bounds[3], area_of.crs), (37.6, None));
        let area_of = area("312000,4160000,312128,4160128,EPSG:32637").expect("metres");
        assert_eq!(area_of.crs.as_deref(), Some("EPSG:32637"));
        for bad in ["1,2,3", "3,2,1,4", "1,2,3,nan", "200,0,201,1"] {
            assert!(area(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn durations_carry_their_units_and_bare_numbers_are_seconds() {
        for (text, secs) in [
            ("0", 0.0),
            ("90", 90.0),
            ("0.5", 0.5),
            ("90s", 90.0),
            (" 5m ", 300.0),
            ("5 min", 300.0),
            ("1.5h", 5400.0),
            ("1h30m", 5400.0),
            ("1h 30m 5s", 5405.0),
            ("250ms", 0.25),
        ] {
            assert_eq!(duration(text), Ok(Duration::from_secs_f64(secs)), "{text}");
        }
        for bad in ["", "5x", "-3m", "-3", "inf", "nan", "m", "1h-30m", "1e300"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn pairs_suns_and_keys_are_checked() {
        assert_eq!(pair("640, 780"), Ok([640.0, 780.0]));
        assert_eq!(pair("-5,3e1"), Ok([-5.0, 30.0]));
        assert!(pair("1").is_err() && pair("1,2,3").is_err() && pair("a,b").is_err() && pair("nan,1").is_err());
        assert!(sun("250,35").is_ok() && sun("-90, 0").is_ok());
        for bad in [
            "250,95", "0,180", "1e9,40", "0,1e300", "-361,10", "721,10", "0,-91", "10",
        ] {
            assert!(sun(bad).is_err(), "{bad}");
        }
        assert_eq!(key_value("a.b = 3"), Ok(("a.b".to_owned(), "3".to_owned())));
        assert!(key_value("=3").is_err() && key_value("a").is_err());
    }
}
