//! Converts items: one from the command line, or many from the lines of the standard input.
//!
//! With `-` every line of the standard input gives exactly one line of output, in order. A line that cannot be converted
//! gives `{"error":"...","offset":n}`. The other lines are still converted, and the exit code is then 2.

use std::io::{self, BufRead, Read as _, Write};

use bcap_capture::ConvertError;
use bcap_terminal::escape;

use crate::failure::{Failure, item_to_json};
use crate::output::{print_block, print_json};

/// The maximum length of a line: enough for 16 MiB of bytes as digits with separators.
const MAX_LINE: usize = 128 * 1024 * 1024;

/// The items of a command.
pub(crate) enum Items {
    /// One, from the command line.
    One(String),
    /// Those on the lines of the standard input.
    Lines,
}

impl Items {
    /// Creates items from the words of the command line; no words, or a single `-`, select the standard input.
    pub(crate) fn from_words(words: &[String]) -> Self {
        match words {
            [] => Self::Lines,
            [dash] if dash == "-" => Self::Lines,
            words => Self::One(words.join(" ")),
        }
    }

    /// Converts every item and prints the results, as JSON if `json`.
    pub(crate) fn convert(
        self,
        json: bool,
        mut convert: impl FnMut(&[u8], ItemSource) -> Result<String, ConvertError>,
    ) -> Result<(), Failure> {
        match self {
            Self::One(text) => {
                let print = if json { print_json } else { print_block };
                Ok(print(&convert(text.as_bytes(), ItemSource::Argument).map_err(Failure::Item)?)?)
            }
            Self::Lines => {
                let escape = if json { escape::json } else { escape::line };
                let convert = |line: &[u8]| convert(line, ItemSource::Line).map(|converted| escape(&converted));
                let bad = each_line(io::stdin().lock(), io::stdout().lock(), convert)?;
                if bad > 0 { Err(Failure::BadLines(bad)) } else { Ok(()) }
            }
        }
    }
}

/// The source of an item.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ItemSource {
    /// The command line: the output may have several lines.
    Argument,
    /// A line of the standard input: the output has one line.
    Line,
}

/// Converts line by line, and returns the number of invalid lines.
fn each_line(
    mut input: impl BufRead,
    out: impl Write,
    mut convert: impl FnMut(&[u8]) -> Result<String, ConvertError>,
) -> Result<usize, Failure> {
    let mut out = io::BufWriter::new(out);
    let mut line = Vec::new();
    let mut bad = 0;
    while let Some(whole) = read_line(&mut input, &mut line)? {
        let converted = if whole {
            convert(line.strip_suffix(b"\r").unwrap_or(&line))
        } else {
            Err(ConvertError::new(format!("the line is longer than {MAX_LINE} bytes"), MAX_LINE))
        };
        let converted = converted.unwrap_or_else(|error| {
            bad += 1;
            item_to_json(error)
        });
        out.write_all(converted.as_bytes())?;
        out.write_all(b"\n")?;
        out.flush()?;
    }
    Ok(bad)
}

/// Reads a line without its end into `line`: `None` at the end of the input, `Some(false)` if the line is too long.
fn read_line(input: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<Option<bool>> {
    line.clear();
    // a character more than the longest line: the end of the line
    let read = input.by_ref().take(MAX_LINE as u64 + 1).read_until(b'\n', line)?;
    if line.pop_if(|last| *last == b'\n').is_none() && read > MAX_LINE {
        // the rest of the line is skipped
        input.skip_until(b'\n')?;
        return Ok(Some(false));
    }
    Ok((read > 0).then_some(true))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(input: &str) -> (usize, String) {
        let mut out = Vec::new();
        let bad = each_line(input.as_bytes(), &mut out, |line| match line {
            b"bad" => Err(ConvertError::new("it is \"bad\"", 3)),
            line => Ok(format!("<{}>", String::from_utf8_lossy(line))),
        });
        (bad.unwrap(), String::from_utf8(out).unwrap())
    }

    #[test]
    fn every_line_gives_one_line() {
        assert_eq!(run(""), (0, String::new()));
        assert_eq!(run("a\r\n\nb"), (0, "<a>\n<>\n<b>\n".into()));
        assert_eq!(run("a\nbad\nb\nbad\n"), {
            let error = r#"{"error":"it is \"bad\"","offset":3}"#;
            (2, format!("<a>\n{error}\n<b>\n{error}\n"))
        });
    }

    #[test]
    fn a_line_is_assembled_from_small_reads() {
        let mut input = io::BufReader::with_capacity(2, "abcdef\nxyz".as_bytes());
        let mut line = Vec::new();
        assert_eq!(read_line(&mut input, &mut line).unwrap(), Some(true));
        assert_eq!(line, b"abcdef");
        assert_eq!(read_line(&mut input, &mut line).unwrap(), Some(true));
        assert_eq!(line, b"xyz");
        assert_eq!(read_line(&mut input, &mut line).unwrap(), None);
    }
}
