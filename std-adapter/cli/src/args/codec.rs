//! The arguments of `bcap decode`, `bcap encode` and `bcap text`.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

use bcap_capture::Role;

/// Decodes frames, values, or a capture of Wireshark or tcpdump
///
/// Of a capture (FILE.pcap, FILE.pcapng, FILE.cap) it prints the calls with their replies and times: b-CAP over TCP and UDP
/// port 5007, RAC on port 5006, and both on any other port whose first packet shows the protocol. Handles are shown by the
/// names that opened them; missing, repeated and malformed bytes are reported.
///
/// Prints HEX field by field with offsets; HEX may hold several frames in sequence. With `-` each line of the standard input
/// is one item and gives one line of output. An invalid line gives {"error":...,"offset":...}, and the exit code is then 2.
/// HEX may have blanks, colons, commas and 0x prefixes between bytes.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bcap decode 011e000000040000006500000001000a0000000300010000000300000004
  bcap decode --as response --json 01 1c 00 00 00 04 00 00 00 00 00 00 00 01 00 08 00 00 00 0b 00 01 00 00 00 00 00 04
  bcap decode --variant --json 030001000000ffffffff
  bcap decode --json - <frames.hex >frames.jsonl
  bcap decode capture.pcapng
  bcap decode capture.pcapng --error any --object robot
  bcap decode capture.pcapng --stats --function Robot_Execute
  bcap decode capture.pcapng --csv --from 2 --until 3.5")]
pub(crate) struct Decode {
    #[command(flatten)]
    pub(crate) form: Form,

    /// Accepts common errors of peers: trailing bytes, counts and lengths that disagree, unknown types
    #[arg(long)]
    pub(crate) lenient: bool,

    #[command(flatten)]
    pub(crate) capture: CaptureArgs,

    /// The bytes, or the file of a capture; without it, or with `-`, the lines of the standard input
    #[arg(value_name = "HEX|FILE")]
    pub(crate) hex: Vec<String>,
}

/// The parts of a capture to show.
#[derive(Debug, Args)]
#[command(next_help_heading = "Captures")]
pub(crate) struct CaptureArgs {
    /// Only calls of this function: a name or a number of `bcap call --list`, or GET or PUT of RAC
    #[arg(long, value_name = "FUNCTION")]
    pub(crate) function: Option<String>,

    /// Only calls that use or open this object, such as I1, robot or task:Pro1
    #[arg(long, value_name = "NAME")]
    pub(crate) object: Option<String>,

    /// Only calls with this result code, a name or a number; any: calls that failed or have no reply
    #[arg(long, value_name = "CODE", allow_negative_numbers = true)]
    pub(crate) error: Option<String>,

    /// Only what began at this time or later, in seconds since the start of the capture, as the output without --json has them
    #[arg(long, value_name = "SECONDS")]
    pub(crate) from: Option<f64>,

    /// Only what began before this time
    #[arg(long, value_name = "SECONDS")]
    pub(crate) until: Option<f64>,

    /// Prints the calls as CSV with a heading: time, link, serial, function, command, arguments, attempts, hresult, ms, value
    #[arg(long, conflicts_with_all = ["json", "stats"])]
    pub(crate) csv: bool,

    /// Prints for each function the number of calls and errors, and p50, p99 and maximum of the response time; for
    /// Slave Mode also the times between two slvMove requests, and how many are longer than 12 ms
    #[arg(long)]
    pub(crate) stats: bool,
}

impl CaptureArgs {
    /// Returns whether any option was given.
    pub(crate) const fn is_used(&self) -> bool {
        self.function.is_some()
            || self.object.is_some()
            || self.error.is_some()
            || self.from.is_some()
            || self.until.is_some()
            || self.csv
            || self.stats
    }
}

/// Parses the role of frames.
fn role() -> impl TypedValueParser<Value = Role> {
    PossibleValuesParser::new([
        PossibleValue::new("request").help("A client's request: the code is a function"),
        PossibleValue::new("response").help("A server's response: the code is an HRESULT"),
    ])
    .try_map(|role| role.parse::<Role>())
}

/// Encodes frames or values from the JSON that `bcap decode --json` prints
///
/// A frame is {"serial":4,"reserved":0,"code":101,"args":[{"vt":3,"v":3}]}. The defaults are 1 for `serial`, 0 for
/// `reserved` and no `args`; `name` may replace `code`. Unknown fields are errors. With --variant a value is
/// {"vt":3,"v":100}. The output is lower-case hexadecimal digits.
///
/// `v` is a number for numbers, CY (ten-thousandths), DATE (days since 1899-12-30) and ERROR; -1 or 0 for BOOL; a string
/// for BSTR; null for EMPTY and NULL; a list for arrays. Elements of VARIANT arrays are again {"vt":..,"v":..}. Floats that
/// are not finite are "NaN", "inf" and "-inf"; a NaN with other bits is "NaN(0x7ff8000000000001)". An unpaired surrogate is
/// \ud800.
#[derive(Debug, Args)]
#[command(after_help = r#"Examples:
  bcap encode '{"serial":4,"code":101,"args":[{"vt":3,"v":3}]}'
  bcap encode '{"name":"ServiceStart","args":[{"vt":8,"v":"WDT=400"}]}'
  bcap encode --variant '{"vt":8204,"v":[{"vt":8,"v":"Sample"},{"vt":2,"v":100}]}'
  bcap encode - <frames.jsonl >frames.hex"#)]
pub(crate) struct Encode {
    #[command(flatten)]
    pub(crate) form: Form,

    /// The JSON; without it, or with `-`, the lines of the standard input
    #[arg(value_name = "JSON")]
    pub(crate) line: Vec<String>,
}

/// The format of the bytes.
#[derive(Debug, Args)]
pub(crate) struct Form {
    /// The bytes are a single VARIANT instead of a frame
    #[arg(long)]
    pub(crate) variant: bool,

    /// Frames have the CRC of a serial (COM) line
    #[arg(long, conflicts_with = "variant")]
    pub(crate) com: bool,

    /// The kind of the frames, which their bytes do not show
    #[arg(long = "as", value_name = "ROLE", default_value = "request", conflicts_with = "variant", value_parser = role())]
    pub(crate) role: Role,
}

/// Converts values to the text form of RAC, and back
///
/// The text is TYPE,DATA: the VARTYPE as a number, then the data. Parsing the output gives the same bits, except that control
/// characters are printed as \u{1b}; with --json the text is {"text":"8,\u001b"}, which is exact. A value without a text
/// form, such as an empty array, is an error. With `-` each line of the standard input is one item and gives one line of
/// output. An invalid line gives {"error":...,"offset":...}, and the exit code is then 2.
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
        /// The text; without it, or with `-`, the lines of the standard input
        text: Option<String>,
    },
    /// Prints the text of a value
    Print {
        /// The bytes; without it, or with `-`, the lines of the standard input
        #[arg(value_name = "HEX")]
        hex: Vec<String>,
    },
}
