//! The command line.

use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;

use crate::frame::Role;

/// Talks to DENSO robot controllers over b-CAP and RAC, and takes their traffic apart.
#[derive(Debug, Parser)]
#[command(name = "bcap", version, propagate_version = true, after_help = EXIT_CODES)]
pub(crate) struct Cli {
    /// Prints results as JSON, one object a line
    #[arg(long, global = true)]
    pub(crate) json: bool,

    #[command(subcommand)]
    pub(crate) command: Command,
}

const EXIT_CODES: &str = "\
Exit codes: 0 done, 1 the controller refused, 2 wrong usage or malformed input, 3 no connection, 4 no answer in time.
Colours are left out when NO_COLOR is set or the output is not a terminal.";

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    Decode(Decode),
    Encode(Encode),
    Text(Text),
    Completions(Completions),
}

/// Takes frames or values apart
///
/// One HEX is printed field by field with its offsets. With `-` each line of the standard input is one item and gives one
/// line; a bad one gives {"error":...,"offset":...}, and the exit code is 2 at the end. HEX may have blanks, colons, commas
/// and 0x prefixes between bytes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap decode 011e000000040000006500000001000a0000000300010000000300000004
  bcap decode --as response --json 01 1c 00 00 00 04 00 00 00 00 00 00 00 01 00 08 00 00 00 0b 00 01 00 00 00 00 00 04
  bcap decode --variant --json 030001000000ffffffff
  bcap decode --json - <frames.hex >frames.jsonl")]
pub(crate) struct Decode {
    #[command(flatten)]
    pub(crate) form: Form,

    /// Tolerates what peers in the field get wrong: slack, counts and argument lengths that disagree, unknown types
    #[arg(long)]
    pub(crate) lenient: bool,

    /// The bytes; `-` or nothing reads lines
    #[arg(value_name = "HEX")]
    pub(crate) hex: Vec<String>,
}

/// Makes frames or values from the JSON that `bcap decode --json` prints
///
/// A frame is {"serial":4,"reserved":0,"code":101,"args":[{"vt":3,"v":3}]}: `serial` is 1, `reserved` 0 and `args` empty
/// when they are left out, and `name` may stand for `code`. A field of another name is an error. With --variant a value is
/// {"vt":3,"v":100}. The output is hexadecimal digits in lower case.
///
/// `v` is a number for numbers, CY (ten-thousandths), DATE (days since 1899-12-30) and ERROR, -1 or 0 for BOOL, a string
/// for BSTR, null for EMPTY and NULL, a list for arrays; elements of VARIANT arrays are again {"vt":..,"v":..}. Floats that
/// are not finite are "NaN", "inf", "-inf", and "NaN(0x7ff8000000000001)" for a NaN of other bits; a surrogate without its
/// partner is written \ud800.
#[derive(Debug, Args)]
#[command(after_help = r#"Examples:
  bcap encode '{"serial":4,"code":101,"args":[{"vt":3,"v":3}]}'
  bcap encode '{"name":"ServiceStart","args":[{"vt":8,"v":"WDT=400"}]}'
  bcap encode --variant '{"vt":8204,"v":[{"vt":8,"v":"Sample"},{"vt":2,"v":100}]}'
  bcap encode - <frames.jsonl >frames.hex"#)]
pub(crate) struct Encode {
    #[command(flatten)]
    pub(crate) form: Form,

    /// The JSON; `-` or nothing reads lines
    #[arg(value_name = "JSON")]
    pub(crate) line: Vec<String>,
}

/// What the bytes are.
#[derive(Debug, Args)]
pub(crate) struct Form {
    /// The bytes are a single VARIANT instead of a frame
    #[arg(long)]
    pub(crate) variant: bool,

    /// Frames are those of a serial (COM) line, with a CRC
    #[arg(long, conflicts_with = "variant")]
    pub(crate) com: bool,

    /// What the frames are: nothing in their bytes tells
    #[arg(long = "as", value_name = "ROLE", default_value = "request", conflicts_with = "variant")]
    pub(crate) role: Role,
}

/// Turns values into the text that RAC carries, and back
///
/// The text is TYPE,DATA: the VARTYPE as a number, then the data. What is printed parses back to the same bits; a value that
/// has no text, such as an empty array, is an error. With `-` each line of the standard input is one item and gives one
/// line; a bad one gives {"error":...,"offset":...}, and the exit code is 2 at the end.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap text parse '8204,(8,Sample),(2,100)'
  bcap text parse --json '8196,1,2.5,-3e9'
  bcap text print 0300010000007b000000
  bcap text parse - <values.txt | bcap text print -")]
pub(crate) struct Text {
    #[command(subcommand)]
    pub(crate) command: TextCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum TextCommand {
    /// Prints the bytes of a value, as hexadecimal digits, or as JSON with --json
    Parse {
        /// The text; `-` or nothing reads lines
        text: Option<String>,
    },
    /// Prints the text of a value
    Print {
        /// The bytes; `-` or nothing reads lines
        #[arg(value_name = "HEX")]
        hex: Vec<String>,
    },
}

/// Prints the completions for a shell
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap completions bash >~/.local/share/bash-completion/completions/bcap
  bcap completions zsh >~/.zfunc/_bcap
  bcap completions fish >~/.config/fish/completions/bcap.fish")]
pub(crate) struct Completions {
    /// The shell
    pub(crate) shell: Shell,
}
