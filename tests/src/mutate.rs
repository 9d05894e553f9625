//! Damage to valid inputs, the same every time: cuts, flipped bits, numbers of other sizes, repetitions, depth.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg32;

/// Replacements of a number.
const NUMBERS: [&str; 16] = [
    "0",
    "-1",
    "1e308",
    "-1e308",
    "1e999",
    "nan",
    "inf",
    "1e-320",
    "18446744073709551615",
    "18446744073709551616",
    "9223372036854775807",
    "4294967296",
    "1000000000000",
    "99999999999999999999999999999999",
    "0x10",
    "1_000",
];

/// Copies of `input` with damage: empty and extended ones, `count` with random damage, one for each number of the text,
/// and long or deep ones.
pub fn mutations(input: &[u8], seed: u64, count: usize) -> Vec<Vec<u8>> {
    let mut random = Pcg32::seed_from_u64(seed);
    let mut out = vec![
        input.to_vec(),
        Vec::new(),
        [b"\xef\xbb\xbf", input].concat(),
        [input, b"\0\xff\xfe"].concat(),
    ];
    let spans = number_spans(input);
    for _ in 0..count {
        let mut copy = input.to_vec();
        for _ in 0..random.random_range(1..4) {
            copy = damaged(copy, &mut random);
        }
        out.push(copy);
    }
    for (place, span) in spans.iter().enumerate() {
        let with = NUMBERS[(place + seed as usize) % NUMBERS.len()];
        out.push([&input[..span.0], with.as_bytes(), &input[span.1..]].concat());
    }
    out.extend(monsters(input));
    out
}

fn damaged(mut bytes: Vec<u8>, random: &mut Pcg32) -> Vec<u8> {
    if bytes.is_empty() {
        return bytes;
    }
    let at = random.random_range(0..bytes.len());
    let to = random.random_range(at..bytes.len());
    match random.random_range(0..6) {
        0 => bytes.truncate(at),
        1 => bytes[at] ^= 1 << random.random_range(0..8),
        2 => drop(bytes.drain(at..(to).min(at + 40))),
        3 => {
            let part = bytes[at..to.min(at + 400)].to_vec();
            bytes.splice(at..at, part);
        }
        4 => {
            let spans = number_spans(&bytes);
            if let Some(&(from, to)) = spans.get(random.random_range(0..spans.len().max(1))) {
                bytes.splice(from..to, NUMBERS[random.random_range(0..NUMBERS.len())].bytes());
            }
        }
        _ => bytes[at] = random.random(),
    }
    bytes
}

/// Spans of the numbers in a text.
fn number_spans(bytes: &[u8]) -> Vec<(usize, usize)> {
    let part = |b: u8| b.is_ascii_digit() || matches!(b, b'.' | b'+' | b'-' | b'e' | b'E');
    let mut spans = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        if bytes[at].is_ascii_digit() {
            let end = bytes[at..]
                .iter()
                .position(|&b| !part(b))
                .map_or(bytes.len(), |n| at + n);
            spans.push((at, end));
            at = end;
        }
        at += 1;
    }
    spans
}

/// Inputs that are deep, long or repeated.
fn monsters(input: &[u8]) -> Vec<Vec<u8>> {
    const DEEP: usize = 30_000;
    let middle = input.len() / 2;
    let inside =
        |what: &str, times: usize| [&input[..middle], what.repeat(times).as_bytes(), &input[middle..]].concat();
    vec![
        "[".repeat(DEEP).into_bytes(),
        "{\"a\":".repeat(DEEP).into_bytes(),
        "<a>".repeat(DEEP).into_bytes(),
        format!("a = {}", "[".repeat(DEEP)).into_bytes(),
        format!("{}1", "a.".repeat(DEEP)).into_bytes(),
        inside("9", 200_000),
        inside("\n", 200_000),
        inside(" x=1;\n", 20_000),
        inside("&lol;", 10_000),
        input.repeat(20),
        b"<!DOCTYPE l [<!ENTITY a \"aaaaaaaaaa\"><!ENTITY b \"&a;&a;&a;&a;&a;&a;&a;&a;\"><!ENTITY c \"&b;&b;&b;&b;&b;&b;&b;&b;\">]><isd>&c;</isd>"
            .to_vec(),
    ]
}
