//! Makes a scene: `cargo run --release -p heliosplat-synth --example satellite -- OUT [tiny|block|city|district] [SEED]`.

use heliosplat_synth::{SatelliteRequest, Site, write_satellite};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = PathBuf::from(arguments.next().ok_or("say where to write the scene")?);
    let site = match arguments.next().as_deref() {
        Some("tiny") => Site::Tiny,
        None | Some("block") => Site::Block,
        Some("city") => Site::City,
        Some("district") => Site::District,
        Some(other) => return Err(format!("no site is called {other}: tiny, block, city or district").into()),
    };
    let seed = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let request = SatelliteRequest {
        site,
        seed,
        ..Default::default()
    };
    let start = std::time::Instant::now();
    let summary = write_satellite(&request, &out, &|_, _| {})?;
    println!("{}", serde_json::to_string_pretty(&summary)?);
    eprintln!("{:.1} s", start.elapsed().as_secs_f64());
    Ok(())
}
