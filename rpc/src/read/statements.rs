//! The statements of vendors' text files: `key = value;` with groups and lists (IMD, RPB, PVL), and `key: value` lines.

/// `text` without the byte order mark that some editors write.
pub(super) fn without_mark(text: &str) -> &str {
    text.trim_start_matches('\u{feff}')
}

/// A `key = value` statement; the value is a slice of the text, brackets of a list included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Statement<'a> {
    /// Text before `=` or `:`, trimmed.
    pub(super) key: &'a str,
    /// Text behind it, trimmed.
    pub(super) value: &'a str,
}

/// The statements of an IMD, RPB or PVL text, in order; groups are ignored, for keys that have one meaning in all
/// groups.
pub(super) fn assignments(text: &str) -> Vec<Statement<'_>> {
    grouped(text).into_iter().map(|(_, statement)| statement).collect()
}

/// Statements in order, each with its innermost group; the group is empty outside of all groups.
pub(super) fn grouped(text: &str) -> Vec<(&str, Statement<'_>)> {
    let mut statements = Vec::new();
    let mut groups = Vec::new();
    let mut rest = without_mark(text);
    while let Some(equals) = rest.find('=') {
        // The key is the text before "=" on its own line.
        let before = &rest[..equals];
        let key = before.rsplit(['\n', '\r', ';']).next().unwrap_or(before).trim();
        let after = rest[equals + 1..].trim_start();
        let end = if after.starts_with('(') {
            after.find(')').map_or(after.len(), |close| close + 1)
        } else {
            after.find(['\n', '\r', ';']).unwrap_or(after.len())
        };
        let value = after[..end].trim();
        rest = &after[end..];
        match key.to_ascii_uppercase().as_str() {
            "BEGIN_GROUP" | "GROUP" | "OBJECT" => groups.push(value),
            "END_GROUP" => {
                groups.pop();
            }
            _ => statements.push((groups.last().copied().unwrap_or(""), Statement { key, value })),
        }
    }
    statements
}

/// The `key: value` lines of a text, in order.
pub(super) fn colon_lines(text: &str) -> impl Iterator<Item = Statement<'_>> {
    without_mark(text).lines().filter_map(|line| {
        let (key, value) = line.split_once(':')?;
        Some(Statement {
            key: key.trim(),
            value: value.trim(),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_lists_and_quotes_are_told_apart() {
        let text = "satId = \"WV03\";\r\nBEGIN_GROUP = IMAGE\n\terrBias =    1.49;\n lineNumCoef = (\n +1E-03,\n-2);\n\
                    pixelScale = \n(\n 7\n);\nEND_GROUP = IMAGE\nEND;";
        let found: Vec<(&str, &str)> = assignments(text).iter().map(|s| (s.key, s.value)).collect();
        assert_eq!(
            found,
            [
                ("satId", "\"WV03\""),
                ("errBias", "1.49"),
                ("lineNumCoef", "(\n +1E-03,\n-2)"),
                ("pixelScale", "(\n 7\n)")
            ]
        );
    }

    #[test]
    fn statements_know_their_group() {
        let text = "a = 1;\nBEGIN_GROUP = BAND_R\n\tgain = 2;\nEND_GROUP = BAND_R\nBEGIN_GROUP = BAND_N\n\tgain = 3;\nEND_GROUP = BAND_N\nb = 4;";
        let found: Vec<_> = grouped(text).iter().map(|(group, s)| (*group, s.value)).collect();
        assert_eq!(found, [("", "1"), ("BAND_R", "2"), ("BAND_N", "3"), ("", "4")]);
    }

    #[test]
    fn text_cut_anywhere_still_ends() {
        let text = "a = (1, 2);\nb = 3;\n=\n= =;c=(";
        for end in 0..=text.len() {
            assert!(assignments(&text[..end]).len() <= 8);
        }
    }
}
