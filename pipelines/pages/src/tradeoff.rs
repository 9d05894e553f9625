//! Speed against accuracy on the user's own scenes: the points that are tried, and the page of their trainings.

pub mod page;
pub mod points;
pub mod summary;

/// One training.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Row {
    /// Name of the scene's folder.
    pub scene: String,
    /// Name of the point.
    pub point: String,
    /// Seed of the training.
    pub seed: u64,
    /// Seconds in all.
    pub seconds: f64,
    /// Processor seconds of all threads.
    pub processor_s: f64,
    /// Most memory used, bytes.
    pub peak_bytes: f64,
    /// Gaussians at the end.
    pub gaussians: f64,
    /// Steps.
    pub steps: f64,
    /// Mean absolute error of the DSM, metres, protocol `raw`.
    pub mae_m: Option<f64>,
    /// Its median, metres.
    pub median_m: Option<f64>,
    /// Share of pixels whose shadow is right.
    pub shadows_right: Option<f64>,
    /// Peak signal-to-noise ratio of images trained on, dB.
    pub psnr_train: Option<f64>,
    /// PSNR of held-out images, dB.
    pub psnr_held_out: Option<f64>,
}

/// The rows as a table of text.
pub fn csv(rows: &[Row]) -> String {
    let mut out =
        "scene,point,seed,seconds,processor_s,peak_mib,gaussians,steps,mae_m,median_m,shadows_right,psnr_train,psnr_held_out\n"
            .to_owned();
    let may = |value: Option<f64>| value.map_or(String::new(), |v| format!("{v:.4}"));
    for row in rows {
        let scene = crate::page::csv_text(&row.scene);
        out += &format!(
            "{scene},{},{},{:.2},{:.2},{:.1},{:.0},{:.0},{},{},{},{},{}\n",
            row.point,
            row.seed,
            row.seconds,
            row.processor_s,
            row.peak_bytes / f64::from(1 << 20),
            row.gaussians,
            row.steps,
            may(row.mae_m),
            may(row.median_m),
            may(row.shadows_right),
            may(row.psnr_train),
            may(row.psnr_held_out),
        );
    }
    out
}
