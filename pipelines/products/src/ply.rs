//! `model.ply`: Gaussians in the layout that splat viewers read (positions, `f_dc` colours, opacity logit, log scales,
//! quaternion with the scalar first), and the exact albedo of every band besides.

use heliosplat::gaussians::{LOG_SCALE, OPACITY, POSITION, ROTATION, Table, core_groups};
use heliosplat::model::SceneModel;
use heliosplat::model::shadow_gs::{ALBEDO, ShadowGs};
use heliosplat_exchange::ply::{Rows, header};
use heliosplat_exchange::splats::C0;

fn properties(extra: &[(String, usize)]) -> Vec<String> {
    let mut names: Vec<String> = [
        "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    ]
    .map(String::from)
    .to_vec();
    names.extend(["rot_0", "rot_1", "rot_2", "rot_3"].map(String::from));
    for (name, width) in extra {
        names.extend((0..*width).map(|k| format!("{name}_{k}")));
    }
    names
}

fn extra(table: &Table) -> Vec<(String, usize)> {
    table.groups[ALBEDO..]
        .iter()
        .map(|g| (g.spec.name.clone(), g.spec.width))
        .collect()
}

/// The file of a table whose first model group is the albedo of `bands` bands.
pub fn encode(gaussians: &Table, bands: usize) -> Vec<u8> {
    let extra = extra(gaussians);
    let mut out = header(&[], gaussians.count, properties(&extra).iter().map(String::as_str));
    let mut put = |v: f32| out.extend_from_slice(&v.to_le_bytes());
    for i in 0..gaussians.count {
        gaussians.group(POSITION)[i * 3..i * 3 + 3].iter().for_each(|&v| put(v));
        let albedo = &gaussians.group(ALBEDO)[i * bands..(i + 1) * bands];
        for k in 0..3 {
            // Display gamma, so that a viewer without tone mapping shows something; grey where there is one band.
            let linear = albedo[if bands < 3 { 0 } else { k }];
            put((linear.clamp(0.0, 1.0).powf(1.0 / 2.2) - 0.5) / C0);
        }
        put(gaussians.group(OPACITY)[i]);
        gaussians.group(LOG_SCALE)[i * 3..i * 3 + 3]
            .iter()
            .for_each(|&v| put(v));
        let q = gaussians.raw_rotation(i);
        [q[3], q[0], q[1], q[2]].into_iter().for_each(&mut put);
        for group in &gaussians.groups[ALBEDO..] {
            let width = group.spec.width;
            group.values[i * width..(i + 1) * width].iter().for_each(|&v| put(v));
        }
    }
    out
}

/// The table of a file written by [`encode`] for `model`.
///
/// # Errors
/// A sentence that says what is wrong with the file.
pub fn decode(bytes: &[u8], model: &ShadowGs) -> Result<Table, String> {
    let rows = Rows::open(bytes)?;
    let mut groups = core_groups();
    groups.extend(model.feature_groups());
    let extra: Vec<(String, usize)> = model.feature_groups().into_iter().map(|g| (g.name, g.width)).collect();
    if rows.columns != properties(&extra) {
        return Err("its properties are not those of the model beside it".into());
    }
    let mut table = Table::zeros(groups, rows.count);
    for i in 0..rows.count {
        let value = |at: usize| rows.value(i, at);
        for k in 0..3 {
            table.group_mut(POSITION)[i * 3 + k] = value(k);
            table.group_mut(LOG_SCALE)[i * 3 + k] = value(7 + k);
        }
        table.group_mut(OPACITY)[i] = value(6);
        for (k, at) in [11, 12, 13, 10].into_iter().enumerate() {
            table.group_mut(ROTATION)[i * 4 + k] = value(at);
        }
        let mut at = 14;
        for group in &mut table.groups[ALBEDO..] {
            for k in 0..group.spec.width {
                group.values[i * group.spec.width + k] = value(at);
                at += 1;
            }
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
    use heliosplat::model::shadow_gs::ShadowGsOptions;

    fn case() -> (ShadowGs, Table) {
        case_of(0, false)
    }

    fn case_of(degree: usize, near_light: bool) -> (ShadowGs, Table) {
        let model = ShadowGs::new(ShadowGsOptions {
            bands: 4,
            degree,
            near_light,
            ..ShadowGsOptions::default()
        });
        let mut groups = core_groups();
        groups.extend(model.feature_groups());
        let mut table = Table::zeros(groups, 5);
        for group in &mut table.groups {
            for (i, v) in group.values.iter_mut().enumerate() {
                *v = (i as f32 * 0.37).sin();
            }
        }
        (model, table)
    }

    #[test]
    fn a_table_reads_back_to_the_same_bits() {
        for (model, table) in [case(), case_of(2, false), case_of(3, true)] {
            assert_eq!(decode(&encode(&table, 4), &model), Ok(table));
        }
    }

    #[test]
    fn a_file_that_claims_too_much_is_refused() {
        let (model, table) = case();
        let text = encode(&table, 4);
        let huge = String::from_utf8_lossy(&text[..90]).replace("vertex 5", "vertex 1000000000000");
        let mut bytes = huge.into_bytes();
        bytes.extend_from_slice(&text[90..]);
        assert!(decode(&bytes, &model).is_err());
        assert!(decode(&text[..text.len() - 4], &model).is_err());
        assert!(decode(b"", &model).is_err());
    }
}
