//! Point clouds of reconstructions, from which a training may start.

use glam::DVec3;
use heliosplat_exchange::ply;

/// A point in the frame of the cameras with its display colour, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Position in the capture's units.
    pub position: DVec3,
    /// Red, green and blue.
    pub colour: [f32; 3],
}

impl Point {
    /// A point with a colour of 0 to 255; `None` for a position that is not finite.
    pub(super) fn new(position: [f64; 3], colour: [f64; 3]) -> Option<Self> {
        let position = DVec3::from(position);
        position.is_finite().then(|| Self {
            position,
            colour: colour.map(|c| (c / 255.0).clamp(0.0, 1.0) as f32),
        })
    }
}

/// Bytes of a PLY type.
fn size_of_type(name: &str) -> Option<usize> {
    Some(match name {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
        "double" | "float64" => 8,
        _ => return None,
    })
}

/// A number of a PLY type in little-endian order; integers of two and four bytes occur in no column that is read.
fn number(bytes: &[u8]) -> f64 {
    match *bytes {
        [byte] => f64::from(byte),
        [a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
        _ => bytes.try_into().map_or(f64::NAN, f64::from_le_bytes),
    }
}

/// Points of a PLY file, text or binary little-endian, with the properties `x`, `y`, `z` and, where present, `red`,
/// `green`, `blue` of 0 to 255.
///
/// # Errors
/// A sentence on the fault.
pub fn read_ply(bytes: &[u8]) -> Result<Vec<Point>, String> {
    let (header, body) = ply::split(bytes)?;
    // Columns of the vertices, which must be the first element.
    let (mut binary, mut count, mut columns) = (false, None, Vec::new());
    for line in header.lines() {
        match *line.split_ascii_whitespace().collect::<Vec<_>>() {
            ["format", format, _] => match format {
                "ascii" => {}
                "binary_little_endian" => binary = true,
                _ => {
                    return Err(format!(
                        "its format is {format}; ascii and binary_little_endian are read"
                    ));
                }
            },
            ["element", "vertex", n] if count.is_none() => count = n.parse::<usize>().ok(),
            ["element", ..] if count.is_none() => return Err("its first element is not the vertices".into()),
            ["element", ..] => break,
            ["property", kind, name] => {
                let size = size_of_type(kind).ok_or(format!("its property {name} is of the type {kind}"))?;
                columns.push((name, size));
            }
            ["property", ..] => return Err("its vertices have lists".into()),
            _ => {}
        }
    }
    let count = count.ok_or("it does not state its number of points")?;
    let place = |name: &str| columns.iter().position(|(column, _)| *column == name);
    let place = |name: &str| place(name).ok_or(format!("it has no property {name}"));
    let position = [place("x")?, place("y")?, place("z")?];
    let colour = [place("red"), place("green"), place("blue")];
    let of_row = |values: &[f64]| {
        let colour = colour
            .each_ref()
            .map(|place| place.as_ref().map_or(127.5, |&place| values[place]));
        let position = position.map(|place| values[place]);
        Point::new(position, colour).ok_or_else(|| format!("a point is at {position:?}"))
    };
    let short = || format!("it has fewer than the {count} points that it states");
    let mut values = vec![0.0; columns.len()];
    let mut points = Vec::new();
    if binary {
        let width: usize = columns.iter().map(|(_, size)| size).sum();
        let mut rows = body.chunks_exact(width);
        for _ in 0..count {
            let mut row = rows.next().ok_or_else(short)?;
            for (value, (_, size)) in values.iter_mut().zip(&columns) {
                let (own, rest) = row.split_at(*size);
                (*value, row) = (number(own), rest);
            }
            points.push(of_row(&values)?);
        }
        return Ok(points);
    }
    let text = std::str::from_utf8(body).map_err(|_| "its points are not text")?;
    let mut words = text.split_ascii_whitespace();
    for _ in 0..count {
        for value in &mut values {
            let word = words.next().ok_or_else(short)?;
            *value = word.parse().map_err(|_| format!("{word:?} is not a number"))?;
        }
        points.push(of_row(&values)?);
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_binary_clouds_are_the_same_points() {
        let header = |format: &str| {
            format!(
                "ply\nformat {format} 1.0\ncomment a\nelement vertex 2\nproperty float x\nproperty float y\nproperty double z\nproperty uint8 red\nproperty uint8 green\nproperty uint8 blue\nend_header\n"
            )
        };
        let text = header("ascii") + "1 2 3 255 0 51\n-1 -2 -3.5 0 0 0\n";
        let mut binary = header("binary_little_endian").into_bytes();
        for (position, colour) in [([1.0f32, 2.0, 3.0], [255u8, 0, 51]), ([-1.0, -2.0, -3.5], [0; 3])] {
            binary.extend(position[0].to_le_bytes());
            binary.extend(position[1].to_le_bytes());
            binary.extend(f64::from(position[2]).to_le_bytes());
            binary.extend(colour);
        }
        let points = read_ply(text.as_bytes()).expect("a sound file");
        assert_eq!(points.len(), 2);
        assert_eq!(points[0].position, DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(points[0].colour, [1.0, 0.0, 0.2]);
        assert_eq!(read_ply(&binary), Ok(points));
        assert!(read_ply(&binary[..binary.len() - 1]).is_err_and(|e| e.contains("fewer")));
        let many = text.replace("vertex 2", "vertex 99999999999999");
        assert!(read_ply(many.as_bytes()).is_err());
        assert!(read_ply(text.replace("float x", "list uchar int x").as_bytes()).is_err());
        assert!(
            read_ply(text.replace("property float x\n", "").as_bytes()).is_err_and(|e| e.contains("no property x"))
        );
    }
}
