//! Parsing of XML within limits, and searches by local name.
//!
//! The parser neither recurses nor reads DTDs, but its time and memory grow with the square of some counts; these
//! counts are checked before parsing, against limits far above any product description.

use super::error::ReadError;
use super::statements::without_mark;
use roxmltree::{Document, Node};

/// Largest text, bytes. Product descriptions reach half a megabyte.
const LARGEST_BYTES: usize = 16 << 20;
const MOST_TAGS: usize = 1 << 20;
const MOST_EQUALS: usize = 1 << 20;
/// Largest number of attributes of one element: the parser compares each pair for duplicates.
const MOST_EQUALS_PER_TAG: usize = 1 << 14;
/// Largest number of namespaces: the parser copies them from parent to child.
const MOST_NAMESPACES: usize = 1 << 10;

/// Parses `text`; a text beyond the limits, or one that is no XML, is malformed.
pub(super) fn parse<'a>(format: &'static str, text: &'a str) -> Result<Document<'a>, ReadError> {
    let malformed = |reason: String| ReadError::Malformed { format, reason };
    check_limits(text).map_err(malformed)?;
    // Byte order marks and blank lines before the declaration are common and harmless.
    let text = without_mark(text).trim_start();
    Document::parse(text).map_err(|error| malformed(error.to_string()))
}

fn check_limits(text: &str) -> Result<(), String> {
    let within = |count: usize, most: usize, what: &str| {
        (count <= most)
            .then_some(())
            .ok_or_else(|| format!("{count} {what}, more than the {most} that are read"))
    };
    within(text.len(), LARGEST_BYTES, "bytes of XML")?;
    within(text.bytes().filter(|b| *b == b'<').count(), MOST_TAGS, "tags")?;
    within(text.bytes().filter(|b| *b == b'=').count(), MOST_EQUALS, "attributes")?;
    within(text.matches("xmlns").count(), MOST_NAMESPACES, "namespaces")?;
    let per_tag = text
        .split('<')
        .map(|tag| tag.bytes().filter(|b| *b == b'=').count())
        .max();
    within(per_tag.unwrap_or(0), MOST_EQUALS_PER_TAG, "attributes of one element")
}

/// The first element called `name` (namespace ignored) at or below `node`.
pub(super) fn find<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    find_all(node, name).next()
}

/// All elements called `name` at or below `node`.
pub(super) fn find_all<'a, 'i>(node: Node<'a, 'i>, name: &str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.descendants()
        .filter(move |n| n.is_element() && n.tag_name().name() == name)
}

/// The text of the first child element called `name`.
pub(super) fn child_text<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    node.children()
        .find(|n| n.is_element() && n.tag_name().name() == name)?
        .text()
}

/// The text of the first element called `name` at or below `node`.
pub(super) fn text<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    find(node, name)?.text()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn documents_made_to_exhaust_a_parser_end_quickly() {
        let deep = "<a>".repeat(300_000) + &"</a>".repeat(300_000);
        let wide = (0..200_000).fold(String::from("<a "), |text, i| text + &format!("b{i}='' ")) + "/>";
        let spaces = (0..50_000).fold(String::new(), |text, i| text + &format!("<a xmlns:b{i}='c{i}'>"));
        let entities = "<!DOCTYPE a [<!ENTITY b 'xxxx'><!ENTITY c '&b;&b;&b;'>]><a>&c;</a>".to_owned();
        let equals = "<a>".to_owned() + &"=".repeat(4 << 20) + "</a>";
        let large = "<a>".to_owned() + &" ".repeat(LARGEST_BYTES) + "</a>";
        for (name, text) in [
            ("wide", wide),
            ("spaces", spaces),
            ("entities", entities),
            ("equals", equals),
            ("large", large),
            ("unclosed", "<".repeat(1 << 20)),
        ] {
            let start = Instant::now();
            assert!(
                matches!(parse("test", &text), Err(ReadError::Malformed { .. })),
                "{name}"
            );
            assert!(
                start.elapsed() < Duration::from_secs(5),
                "{name} took {:?}",
                start.elapsed()
            );
        }
        // Deep is harmless: neither parsing, searching nor dropping recurses.
        let document = parse("test", &deep).expect("well-formed");
        assert_eq!(find_all(document.root_element(), "a").count(), 300_000);
    }
}
