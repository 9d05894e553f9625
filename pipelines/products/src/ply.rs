//! `model.ply`: Gaussians in the layout that splat viewers read (positions, `f_dc` colours, opacity logit, log scales,
//! quaternion with the scalar first), and the exact albedo of every band besides.

use heliosplat::gaussians::Table;
use heliosplat::model::SceneModel;
use heliosplat::model::shadow_gs::{ALBEDO, ShadowGs};
use heliosplat_exchange::splat_ply;
use heliosplat_exchange::splats::C0;

/// Bytes of the PLY file of Gaussians whose albedo has `bands` bands; viewers see the albedo as display values (gamma
/// 2.2).
pub fn encode(gaussians: &Table, bands: usize) -> Vec<u8> {
    let albedo = gaussians.group(ALBEDO);
    let shown = |i: usize| {
        [0, 1, 2].map(|k| {
            let linear = albedo[i * bands + if bands < 3 { 0 } else { k }];
            (linear.clamp(0.0, 1.0).powf(1.0 / 2.2) - 0.5) / C0
        })
    };
    splat_ply::encode_shown(gaussians, &shown)
}

/// Gaussians of a PLY file, which must hold all columns of `model`.
///
/// # Errors
/// A sentence on the fault of the file.
pub fn decode(bytes: &[u8], model: &ShadowGs) -> Result<Table, String> {
    splat_ply::decode(bytes, model.feature_groups())
}

#[cfg(test)]
mod tests {
    use super::*;
    use heliosplat::gaussians::core_groups;
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
