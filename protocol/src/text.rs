//! Text that a peer wrote. It is shown only with its control characters escaped.

use std::fmt::{self, Write as _};

use serde::{Deserialize, Serialize};

/// A text from the wire. A terminal, a log or a window may show what `Display` or `Debug` write, and nothing else: both
/// escape what could forge a line, move a cursor, reorder a line or hide in it.
#[derive(Clone, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct PeerText(String);

impl PeerText {
    /// The bytes as they crossed the wire: to be parsed or measured, never to be shown.
    #[must_use]
    pub fn unescaped(&self) -> &str {
        &self.0
    }

    /// Returns the text of bytes that may not be UTF-8, such as the reason of a closed connection.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Self {
        Self(String::from_utf8_lossy(bytes).into_owned())
    }
}

impl From<String> for PeerText {
    fn from(text: String) -> Self {
        Self(text)
    }
}

impl From<&str> for PeerText {
    fn from(text: &str) -> Self {
        Self(text.to_owned())
    }
}

impl fmt::Display for PeerText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Escaped(&self.0).fmt(f)
    }
}

impl fmt::Debug for PeerText {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_char('"')?;
        fmt::Display::fmt(self, f)?;
        f.write_char('"')
    }
}

/// Shows a value of a library as [`PeerText`] is shown, because a peer may have written a part of it: QUIC's errors
/// repeat the peer's reason. A second escape changes nothing.
#[derive(Debug, Clone, Copy)]
pub struct Escaped<T>(pub T);

impl<T: fmt::Display> fmt::Display for Escaped<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(Escape(f), "{}", self.0)
    }
}

struct Escape<'a, 'f>(&'a mut fmt::Formatter<'f>);

impl fmt::Write for Escape<'_, '_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        text.chars().try_for_each(|character| self.write_char(character))
    }

    /// The standard library's list of what has no picture of its own: controls, separators of lines, formats (bidi and
    /// zero-width), combining marks, private and unassigned characters.
    fn write_char(&mut self, character: char) -> fmt::Result {
        match character {
            '\'' | '"' | '\\' => self.0.write_char(character),
            _ => write!(self.0, "{}", character.escape_debug()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every character that moves a cursor, ends a line, reorders a line, or is not seen.
    fn hidden() -> impl Iterator<Item = char> {
        let ranges = [
            ('\0', '\u{1f}'),
            ('\u{7f}', '\u{9f}'),
            ('\u{ad}', '\u{ad}'),
            ('\u{61c}', '\u{61c}'),
            ('\u{180e}', '\u{180e}'),
            ('\u{200b}', '\u{200f}'),
            ('\u{2028}', '\u{202e}'),
            ('\u{2060}', '\u{206f}'),
            ('\u{feff}', '\u{feff}'),
            ('\u{fff9}', '\u{fffb}'),
            ('\u{e0001}', '\u{e007f}'),
        ];
        ranges.into_iter().flat_map(|(first, last)| first..=last)
    }

    #[test]
    fn hidden_characters_are_escaped_in_every_form() {
        for character in hidden() {
            let text = PeerText::from(format!("a{character}b"));
            for shown in [text.to_string(), format!("{text:?}"), format!("{:?}", Some(&text)), format!("{text:#?}")] {
                assert!(shown.chars().all(|shown| (' '..='~').contains(&shown)), "{character:?}: {shown}");
                assert!(shown.contains('a') && shown.contains('b') && shown.len() > 3, "{character:?}: {shown}");
            }
            assert_eq!(Escaped(&text).to_string(), text.to_string(), "a second escape changes nothing");
        }
    }

    #[test]
    fn readable_text_stays_as_it_is() {
        let text = "compute on \"NVIDIA\" 5 % \\ it's größer, 東京, 1 → 2 🙂";
        assert_eq!(PeerText::from(text).to_string(), text);
        assert_eq!(PeerText::from_bytes(b"a\xffb").to_string(), "a\u{fffd}b");
        assert_eq!(PeerText::from("\x1b[2J\r\n").to_string(), "\\u{1b}[2J\\r\\n");
    }

    #[test]
    fn the_wire_has_the_text_as_it_was_written() {
        let text = "a\x1b\nb";
        let bytes = postcard::to_stdvec(&PeerText::from(text)).unwrap();
        assert_eq!(bytes, postcard::to_stdvec(text).unwrap());
        assert_eq!(postcard::from_bytes::<PeerText>(&bytes).unwrap().unescaped(), text);
    }
}
