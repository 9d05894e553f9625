//! Times in file names, and the date tag of a TIFF: weaker than metadata, because their meaning is not specified.

use super::time::{month_of, utc};
use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

/// The first year of commercial high-resolution images: an earlier year is a number, not a date.
const FIRST_YEAR: i16 = 1999;
/// The last plausible year.
const LAST_YEAR: i16 = 2099;
/// Most digits of a compact time: milliseconds behind the seconds.
const MOST_DIGITS: usize = 17;

/// The acquisition time in the name of a vendor's file, UTC: the earliest of several, `None` without any. A date alone
/// is no time.
///
/// | vendor | in the name |
/// |---|---|
/// | Maxar | `17OCT19153045-P1BS-…`, `WV03_20171019153045_…` |
/// | Airbus (Pléiades, SPOT) | `IMG_PHR1A_P_201710191530451_SEN_…` |
/// | Planet (PlanetScope, SkySat) | `20171019_153045_12_1054_…`, `20171019_153045_ssc4d3_…` |
/// | KARI (KOMPSAT) | `K3A_20171019153045_…` |
/// | others | `20171019T153045` |
pub fn from_file_name(name: &str) -> Option<Timestamp> {
    let parts: Vec<&str> = name.split(|c: char| !c.is_ascii_alphanumeric()).collect();
    let alone = parts.iter().filter_map(|part| of_part(part));
    let pairs = parts.windows(2).filter_map(|pair| of_date_and_time(pair[0], pair[1]));
    alone.chain(pairs).min()
}

/// One run of letters and digits.
fn of_part(part: &str) -> Option<Timestamp> {
    if let Some((date, time)) = part.split_once(['T', 't']) {
        let time = time.trim_end_matches(['Z', 'z']);
        if let Some(found) = of_date_and_time(date, time.get(..6)?) {
            return Some(found);
        }
    }
    if part.bytes().all(|b| b.is_ascii_digit()) {
        return (14..=MOST_DIGITS)
            .contains(&part.len())
            .then(|| plausible(utc(&part[..14])?))
            .flatten();
    }
    maxar(part)
}

/// `YYYYMMDD` and `hhmmss`.
fn of_date_and_time(date: &str, time: &str) -> Option<Timestamp> {
    let digits = |text: &str, count: usize| text.len() == count && text.bytes().all(|b| b.is_ascii_digit());
    (digits(date, 8) && digits(time, 6)).then(|| plausible(utc(&format!("{date}{time}"))?))?
}

/// `YYMONDDhhmmss`.
fn maxar(part: &str) -> Option<Timestamp> {
    let (year, rest) = part.split_at_checked(2)?;
    let (month, rest) = rest.split_at_checked(3)?;
    let digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    if rest.len() != 8 || !digits(year) || !digits(rest) {
        return None;
    }
    let month = month_of(month)?;
    plausible(utc(&format!("20{year}{month:02}{rest}"))?)
}

fn plausible(time: Timestamp) -> Option<Timestamp> {
    let year = time.to_zoned(TimeZone::UTC).year();
    (FIRST_YEAR..=LAST_YEAR).contains(&year).then_some(time)
}

/// Time in the date tag of a TIFF (tag 306, `YYYY:MM:DD hh:mm:ss`), taken as UTC; `None` for another form or a year
/// outside of 1999 to 2099. Many programs write the time of the file there.
pub fn tiff_date(text: &str) -> Option<Timestamp> {
    let (date, time) = text.trim().trim_end_matches('\0').split_once(' ')?;
    let civil: DateTime = format!("{}T{}", date.replace(':', "-"), time.trim()).parse().ok()?;
    plausible(TimeZone::UTC.to_timestamp(civil).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_vendors_say_when() {
        let expected: Timestamp = "2017-10-19T15:30:45Z".parse().expect("RFC 3339");
        for name in [
            "17OCT19153045-P1BS-500648061070_01_P001",
            "17oct19153045-m2as_r1c1-059876543210_01_p001",
            "WV03_20171019153045_104001003E54AB00_17OCT19153045-P1BS-501504472090_04_P005",
            "IMG_PHR1A_P_201710191530451_SEN_2595652101-001_R1C1",
            "IMG_SPOT7_PMS_201710191530458_SEN_2813234101_R2C1",
            "20171019_153045_12_1054_3B_AnalyticMS",
            "20171019_153045_0f34_1B_AnalyticMS",
            "20171019_153045_ssc4d3_0015_pansharpened",
            "K3A_20171019153045_14012_00231234_L1R_P",
            "ICEYE_20171019T153045Z_crop",
            "20171019T153045123_sub",
        ] {
            assert_eq!(from_file_name(name), Some(expected), "{name}");
        }
    }

    #[test]
    fn a_date_alone_or_a_number_is_no_time() {
        for name in [
            "GF2_PMS1_E113.8_N23.1_20171019_L1A0002677832-PAN1",
            "SV1-01_20171019_L1B0000271844_1012100023690001_01-PAN",
            "JAX_068_013_RGB",
            "10300100C0FFEE00_P001",
            "20171019_993045_ssc4",
            "18991019153045_old",
            "500648061070_01_P001",
            "kahramanmaras_01",
            "99999999_999999",
            "17XXX19153045-P1BS",
            "",
            "été_20171019",
        ] {
            assert_eq!(from_file_name(name), None, "{name}");
        }
    }

    #[test]
    fn of_two_times_the_earlier_is_the_acquisition() {
        let name = "IMG_PHR1B_MS_201304270831234_ORT_20200101101010";
        assert_eq!(
            from_file_name(name),
            Some("2013-04-27T08:31:23Z".parse().expect("RFC 3339"))
        );
    }

    #[test]
    fn a_tiff_says_its_date_with_colons() {
        let expected: Timestamp = "2017-10-19T15:30:45Z".parse().expect("RFC 3339");
        assert_eq!(tiff_date("2017:10:19 15:30:45"), Some(expected));
        for text in ["", "2017:10:19", "0000:00:00 00:00:00", "Thu Oct 19 15:30:45 2017"] {
            assert_eq!(tiff_date(text), None, "{text}");
        }
    }
}
