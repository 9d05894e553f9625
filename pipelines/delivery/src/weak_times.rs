//! Acquisition times of images whose metadata contain neither time nor sun: from vendors' file names, then from TIFF
//! date tags.
//!
//! Neither source is specified, so a time with the sun below 5 degrees at the scene is discarded. A date tag is mostly
//! the time at which a program wrote the file: tags are used only if all of them are plausible times of satellite
//! passes.

use super::draft::Draft;
use super::names::stem;
use heliosplat_rpc::parallax::LEAST_BASE_TO_HEIGHT;
use heliosplat_rpc::read::acquisition;
use heliosplat_rpc::sun::sun_position;
use heliosplat_rpc::{GeoPoint, ImagePoint, LocalFrame, Rpc};
use jiff::{SignedDuration, Timestamp, tz::TimeZone};
use std::path::Path;

/// Lowest sun of an image worth acquiring, degrees above the horizon.
const LOWEST_SUN_DEG: f64 = 5.0;
/// Range of mean solar times of sun-synchronous satellites, hours: most pass at half past ten, some at half past one.
const PASS_HOURS: [f64; 2] = [9.0, 15.0];
/// A tag less than this before the modification time of its file is the time of writing the file.
const FROM_FILE_TIME: SignedDuration = SignedDuration::from_hours(24);

/// Fills in times of drafts without time and sun; `at` is the place of the scene. Each accepted or rejected source adds
/// a line to `warnings`. Drafts with the time of a tag are marked: the time zone of tags is unknown, so their suns may
/// be off by hours.
pub(super) fn fill(drafts: &mut [Draft], at: GeoPoint, warnings: &mut Vec<String>) {
    forget_shared(drafts, warnings);
    let unknown = |draft: &&mut Draft| draft.acquisition.time.is_none() && draft.acquisition.stated_sun().is_none();
    let mut named = 0;
    for draft in drafts.iter_mut().filter(unknown) {
        let Some(time) = acquisition::from_file_name(&stem(draft.file.path())) else {
            continue;
        };
        if elevation_deg(time, at) < LOWEST_SUN_DEG {
            let path = draft.file.path().display();
            warnings.push(format!("{path}: its name says {time}, when the sun was down; not used"));
            continue;
        }
        draft.acquisition.time = Some(time);
        named += 1;
    }
    if named > 0 {
        warnings.push(format!(
            "acquisition times of {named} images are read from their file names; say otherwise with time = \"...\" in a scene.toml"
        ));
    }
    let tag_of = |(place, draft): (usize, &mut Draft)| {
        let tag = draft.file.domain("").remove("TIFFTAG_DATETIME")?;
        Some((place, acquisition::tiff_date(&tag)?))
    };
    let untimed = drafts.iter_mut().enumerate().filter(|(_, draft)| unknown(draft));
    let tagged: Vec<(usize, Timestamp)> = untimed.filter_map(tag_of).collect();
    if tagged.is_empty() {
        return;
    }
    let tag = |&(place, time): &(usize, Timestamp)| {
        let written = written(drafts[place].file.path());
        Tag { time, written }
    };
    let tags: Vec<Tag> = tagged.iter().map(tag).collect();
    match disbelief(&tags, at) {
        Some(reason) => {
            warnings.push(format!(
                "the TIFF date tags of {} images are not used as acquisition times: {reason}",
                tags.len()
            ));
        }
        None => {
            for &(place, time) in &tagged {
                drafts[place].acquisition.time = Some(time);
                drafts[place].time_of_tag = true;
            }
            warnings.push(format!(
                "acquisition times of {} images are read from their TIFF date tags and taken as UTC; say otherwise with time = \"...\" in a scene.toml",
                tags.len()
            ));
        }
    }
}

/// Removes the time of NITF headers where all images of a scene have the same second but different viewpoints: it is
/// the time of writing the files.
fn forget_shared(drafts: &mut [Draft], warnings: &mut Vec<String>) {
    let of_header = |draft: &Draft| {
        let said = acquisition::gdal_domain(&draft.file.domain("")).time;
        said.filter(|time| draft.acquisition.time == Some(*time))
    };
    let [first, others @ ..] = drafts else { return };
    let Some(time) = of_header(first) else { return };
    let is_shared = !others.is_empty() && others.iter().all(|other| of_header(other) == Some(time));
    let apart = |other: &Draft| {
        let (one, two) = (tilt(&first.rpc)?, tilt(&other.rpc)?);
        Some((one[0] - two[0]).hypot(one[1] - two[1]))
    };
    if is_shared && others.iter().filter_map(apart).any(|base| base > LEAST_BASE_TO_HEIGHT) {
        warnings.push(format!(
            "the images look from different places and all state {time}: that is no time of acquisition, and is not used"
        ));
        drafts.iter_mut().for_each(|draft| draft.acquisition.time = None);
    }
}

/// Displacement of the ground point of a camera's central pixel per metre of altitude, metres east and north; `None`
/// where the camera cannot be localised.
fn tilt(rpc: &Rpc) -> Option<[f64; 2]> {
    let at = |height_m: f64| {
        let middle = ImagePoint::new(rpc.sample_offset, rpc.line_offset);
        rpc.localise(middle, height_m).ok()
    };
    // The model's own half range of heights can have any value in damaged RPCs.
    let step_m = 100.0;
    let (low, high) = (at(rpc.height_offset_m)?, at(rpc.height_offset_m + step_m)?);
    let moved = LocalFrame::new(low).enu_from_geo(high);
    Some([moved.x, moved.y].map(|metres| metres / step_m))
}

/// Date tag of a file, and modification time of the file.
struct Tag {
    time: Timestamp,
    written: Option<Timestamp>,
}

fn written(path: &Path) -> Option<Timestamp> {
    let written = std::fs::metadata(path).and_then(|data| data.modified()).ok()?;
    Timestamp::try_from(written).ok()
}

/// Reason against these tags as acquisition times; `None` where they are plausible.
fn disbelief(tags: &[Tag], at: GeoPoint) -> Option<&'static str> {
    let day = |tag: &Tag| tag.time.as_second().div_euclid(86_400);
    if tags.iter().all(|tag| day(tag) == day(&tags[0])) {
        return Some("all are of one day, as if the files had been made then");
    }
    let is_young = |tag: &Tag| tag.written.is_some_and(|written| tag.time > written - FROM_FILE_TIME);
    if tags.iter().any(is_young) {
        return Some("they are as young as the files");
    }
    let solar_hours = |time: Timestamp| {
        let utc = time.to_zoned(TimeZone::UTC);
        let hours = f64::from(utc.hour()) + f64::from(utc.minute()) / 60.0;
        (hours + at.lon_deg / 15.0).rem_euclid(24.0)
    };
    let by_day = |tag: &Tag| {
        (PASS_HOURS[0]..=PASS_HOURS[1]).contains(&solar_hours(tag.time))
            && elevation_deg(tag.time, at) >= LOWEST_SUN_DEG
    };
    (!tags.iter().all(by_day)).then_some("satellites do not pass at those hours")
}

fn elevation_deg(time: Timestamp, at: GeoPoint) -> f64 {
    sun_position(time, at).elevation_rad.to_degrees()
}

#[cfg(test)]
mod tests {
    use super::*;

    const AT: GeoPoint = GeoPoint::new(36.91, 37.58, 700.0);

    fn why(times: &[&str], written: &str) -> Option<&'static str> {
        let tags: Vec<Tag> = times
            .iter()
            .map(|time| Tag {
                time: time.parse().expect("RFC 3339"),
                written: written.parse().ok(),
            })
            .collect();
        disbelief(&tags, AT)
    }

    #[test]
    fn tags_that_look_like_passes_are_believed() {
        assert_eq!(
            why(
                &["2016-04-23T08:34:00Z", "2017-05-01T08:20:00Z"],
                "2020-01-01T00:00:00Z"
            ),
            None
        );
    }

    #[test]
    fn tags_that_say_when_a_program_ran_are_not() {
        let later = "2020-01-01T00:00:00Z";
        let one_day = ["2016-04-23T08:34:00Z", "2016-04-23T09:00:00Z"];
        assert!(why(&one_day, later).is_some_and(|why| why.contains("one day")));
        let evening = ["2016-04-23T08:34:00Z", "2017-05-01T16:20:00Z"];
        assert!(why(&evening, later).is_some_and(|why| why.contains("hours")));
        let young = ["2016-04-23T08:34:00Z", "2017-05-01T08:20:00Z"];
        assert!(why(&young, "2017-05-01T12:00:00Z").is_some_and(|why| why.contains("as young")));
    }
}
