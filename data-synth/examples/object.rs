//! Makes a capture of an object: `cargo run --release -p heliosplat-synth --example object -- OUT
//! [object|olat|reflective] [SEED]`.

use heliosplat_synth::{Capture, Look, ObjectRequest, write_object};
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = PathBuf::from(arguments.next().ok_or("say where to write the capture")?);
    let (capture, look) = match arguments.next().as_deref() {
        None | Some("object") => (Capture::Object, Look::Matte),
        Some("olat") => (Capture::Olat, Look::Translucent),
        Some("reflective") => (Capture::Reflective, Look::Glossy),
        Some(other) => return Err(format!("no capture is called {other}: object, olat or reflective").into()),
    };
    let seed = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let request = ObjectRequest {
        capture,
        look,
        seed,
        views: Some(8),
        held_out: Some(4),
        size_px: 64,
        paths: 16,
    };
    let summary = write_object(&request, &out, &|_, _| {})?;
    println!("{}", serde_json::to_string_pretty(&summary)?);
    Ok(())
}
