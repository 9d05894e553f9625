//! Gaussians as viewers of splats read them: binary PLY of named float columns, `f_dc_*` and `f_rest_*` (all of red,
//! then green, then blue), opacity logit, log scales, quaternion with the scalar first. Further columns of a model
//! follow.

use crate::ply::{Rows, header};
use heliosplat::gaussians::{FEATURES, GroupSpec, LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};

use std::collections::BTreeMap;

/// Prefix of the names of the groups of spherical harmonics; the degree follows it.
const HARMONICS: &str = "sh_";
/// Group of columns whose colour is computed for viewers alone and stored in no group.
const SHOWN: usize = usize::MAX;

/// Column of the file, and its position in the table.
struct Column {
    name: String,
    group: usize,
    component: usize,
}

/// Columns of a table with these groups; where `shown` is set, with colours for viewers alone.
fn columns(specs: &[GroupSpec], shown: bool) -> Vec<Column> {
    let mut all = Vec::new();
    let mut add = |name: String, group: usize, component: usize| all.push(Column { name, group, component });
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        add(axis.into(), POSITION, k);
    }
    let features = specs[FEATURES..].iter();
    let harmonics = features.take_while(|group| group.name.starts_with(HARMONICS)).count();
    for k in 0..3 * usize::from(shown) {
        add(format!("f_dc_{k}"), SHOWN, k);
    }
    for k in 0..3 * harmonics.min(1) {
        add(format!("f_dc_{k}"), FEATURES, k);
    }
    let mut rest = 0;
    for k in 0..3 {
        for degree in 1..harmonics {
            for function in 0..2 * degree + 1 {
                add(format!("f_rest_{rest}"), FEATURES + degree, 3 * function + k);
                rest += 1;
            }
        }
    }
    add("opacity".into(), OPACITY, 0);
    for k in 0..3 {
        add(format!("scale_{k}"), LOG_SCALE, k);
    }
    for (k, component) in [3, 0, 1, 2].into_iter().enumerate() {
        add(format!("rot_{k}"), ROTATION, component);
    }
    for (group, spec) in specs.iter().enumerate().skip(FEATURES + harmonics) {
        for component in 0..spec.width {
            add(format!("{}_{component}", spec.name), group, component);
        }
    }
    all
}

/// Bytes of the PLY file of a table, with `comments` in the header. Harmonics, if any, are the first groups of
/// features.
pub fn encode(gaussians: &Table, comments: &[String]) -> Vec<u8> {
    write(gaussians, comments, None)
}

/// Bytes of the PLY file of a table without harmonics: `shown` gives the colour coefficients (red, green, blue) that
/// viewers show for each Gaussian.
pub fn encode_shown(gaussians: &Table, shown: &dyn Fn(usize) -> [f32; 3]) -> Vec<u8> {
    write(gaussians, &[], Some(shown))
}

fn write(gaussians: &Table, comments: &[String], shown: Option<&dyn Fn(usize) -> [f32; 3]>) -> Vec<u8> {
    let specs: Vec<GroupSpec> = gaussians.groups.iter().map(|g| g.spec.clone()).collect();
    let columns = columns(&specs, shown.is_some());
    let names = columns.iter().map(|column| column.name.as_str());
    let mut out = header(comments, gaussians.count, names);
    out.reserve(gaussians.count * columns.len() * size_of::<f32>());
    for i in 0..gaussians.count {
        let colour = shown.map(|shown| shown(i)).unwrap_or_default();
        for column in &columns {
            let value = match gaussians.groups.get(column.group) {
                Some(group) => group.values[i * group.spec.width + column.component],
                None => colour[column.component],
            };
            out.extend_from_slice(&value.to_le_bytes());
        }
    }
    out
}

/// Table of a file with these groups of features. Columns are found by name, in any order; others are ignored.
///
/// # Errors
/// A sentence on the fault of the file: its framing, a missing column, or values that are not finite.
pub fn decode(bytes: &[u8], features: Vec<GroupSpec>) -> Result<Table, String> {
    let rows = Rows::open(bytes)?;
    let places: BTreeMap<&str, usize> = rows.columns.iter().copied().zip(0..).collect();
    let mut groups = core_groups();
    groups.extend(features);
    let columns = columns(&groups, false);
    let place = |column: &Column| {
        let place = places.get(column.name.as_str()).copied();
        place.ok_or(format!("it has no property {}", column.name))
    };
    // All columns are checked before memory is allocated for the number of rows, which is unbounded without columns.
    let found: Vec<usize> = columns.iter().map(place).collect::<Result<_, _>>()?;
    let mut table = Table::zeros(groups, rows.count);
    for (column, place) in columns.iter().zip(found) {
        let group = &mut table.groups[column.group];
        let width = group.spec.width;
        for i in 0..rows.count {
            group.values[i * width + column.component] = rows.value(i, place);
        }
    }
    if !table.is_finite() {
        return Err("it holds numbers that are not finite".into());
    }
    Ok(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat::model::SceneModel;
    use heliosplat::model::radiance::{Radiance, RadianceOptions};

    fn features() -> Vec<GroupSpec> {
        let mut features = Radiance::new(RadianceOptions::default()).feature_groups();
        features.push(GroupSpec::new("own", 2));
        features
    }

    fn table() -> Table {
        let mut groups = core_groups();
        groups.extend(features());
        let mut table = Table::zeros(groups, 3);
        for (g, group) in table.groups.iter_mut().enumerate() {
            for (i, value) in group.values.iter_mut().enumerate() {
                *value = g as f32 + 0.01 * i as f32;
            }
        }
        table
    }

    #[test]
    fn a_file_reads_back_to_the_same_table() {
        assert_eq!(decode(&encode(&table(), &[]), features()), Ok(table()));
    }

    #[test]
    fn the_layout_is_the_one_of_viewers() {
        let bytes = encode(&table(), &[]);
        let header = String::from_utf8_lossy(&bytes).into_owned();
        for name in ["f_dc_2", "f_rest_44", "opacity", "scale_2", "rot_3", "own_1"] {
            assert!(header.contains(&format!("property float {name}\n")), "{name}");
        }
        assert!(!header.contains("f_rest_45"));
        // All of red before green: the second rest coefficient is the next function's red.
        let specs: Vec<GroupSpec> = table().groups.iter().map(|g| g.spec.clone()).collect();
        let all = columns(&specs, false);
        let rest = all.iter().position(|c| c.name == "f_rest_1").expect("a column");
        assert_eq!((all[rest].group, all[rest].component), (FEATURES + 1, 3));
        assert_eq!(all.iter().find(|c| c.name == "rot_0").expect("a column").component, 3);
    }

    #[test]
    fn damaged_files_are_refused() {
        let bytes = encode(&table(), &[]);
        for cut in [0, 10, bytes.len() - 1] {
            assert!(decode(&bytes[..cut], features()).is_err());
        }
        let claim = String::from_utf8_lossy(&bytes[..60]).replace("vertex 3", "vertex 99999999999");
        assert!(decode(claim.as_bytes(), features()).is_err());
        // No columns at all: then the rows take no bytes, however many there are.
        let nothing = header(&[], usize::MAX / 8, std::iter::empty());
        assert!(decode(&nothing, features()).is_err());
    }
}
