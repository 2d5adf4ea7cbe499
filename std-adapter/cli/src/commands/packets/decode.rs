//! `bcap decode`: converts captures, frames and values between their bytes and text or JSON.

use std::path::Path;
use std::str;
use std::time::Duration;

use bcap_capture::decode::{Event, Filter, Format, Printer, Stats, csv, events, function_name};
use bcap_capture::dissect::dissect;
use bcap_capture::json::{self, LIMITS, Part};
use bcap_capture::value::{self, to_json};
use bcap_capture::{ConvertError, Role, frame, hex};
use bcap_core::bcap::Decoder;
use bcap_core::limits::Strictness;
use bcap_core::variant::{OwnedVariant as Value, Variant};
use bcap_terminal::escape;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::commands::packets::items::{ItemSource, Items};
use crate::failure::Failure;
use crate::output::{print_json, print_line};

/// Decodes frames, values, or a capture of Wireshark or tcpdump; encodes with --reverse
///
/// Of a capture (FILE.pcap, FILE.pcapng, FILE.cap) it prints the calls with their replies and times: b-CAP over TCP and UDP
/// port 5007, RAC on port 5006, and both on any other port whose first packet shows the protocol. Handles are shown by the
/// names that opened them; missing, repeated and malformed bytes are reported.
///
/// Prints HEX field by field with offsets; HEX may hold several frames in sequence. With `-` each line of the standard input
/// is one item and gives one line of output. An invalid line gives {"error":...,"offset":...}, and the exit code is then 2.
/// HEX may have blanks, colons, commas and 0x prefixes between bytes.
///
/// With --reverse it prints the bytes of the JSON that --json prints, as lower-case hexadecimal digits. A frame is
/// {"serial":4,"reserved":0,"code":101,"args":[{"vt":3,"v":3}]}. The defaults are 1 for `serial`, 0 for `reserved` and no
/// `args`; `name` may replace `code`. Unknown fields are errors. With --variant a value is {"vt":3,"v":100}.
///
/// `v` is a number for numbers, CY (ten-thousandths), DATE (days since 1899-12-30) and ERROR; -1 or 0 for BOOL; a string
/// for BSTR; null for EMPTY and NULL; a list for arrays. Elements of VARIANT arrays are again {"vt":..,"v":..}. Floats that
/// are not finite are "NaN", "inf" and "-inf"; a NaN with other bits is "NaN(0x7ff8000000000001)". An unpaired surrogate is
/// \ud800.
///
/// With --rac it prints the text form of a value in RAC, TYPE,DATA: the VARTYPE as a number, then the data; --reverse converts
/// such a text to bytes. Both give the same bits, except that control characters are printed as \u{1b}; with --json the
/// text is {"text":"8,\u001b"}, which is exact. A value without a text form, such as an empty array, is an error.
#[derive(Debug, Args)]
#[command(after_help = r#"Examples:
  bcap decode 011e000000040000006500000001000a0000000300010000000300000004
  bcap decode --as response --json 01 1c 00 00 00 04 00 00 00 00 00 00 00 01 00 08 00 00 00 0b 00 01 00 00 00 00 00 04
  bcap decode --variant --json 030001000000ffffffff
  bcap decode --json - <frames.hex >frames.jsonl
  bcap decode capture.pcapng
  bcap decode capture.pcapng --error any --object robot
  bcap decode capture.pcapng --stats --function Robot_Execute
  bcap decode capture.pcapng --csv --from 2 --until 3.5
  bcap decode --reverse '{"name":"ServiceStart","args":[{"vt":8,"v":"WDT=400"}]}'
  bcap decode --reverse --variant '{"vt":8204,"v":[{"vt":8,"v":"Sample"},{"vt":2,"v":100}]}'
  bcap decode --reverse - <frames.jsonl >frames.hex
  bcap decode --rac 0300010000007b000000
  bcap decode --rac --reverse '8204,(8,Sample),(2,100)'"#)]
pub(crate) struct Decode {
    /// The bytes are a single VARIANT instead of a frame
    #[arg(long)]
    pub(crate) variant: bool,

    /// The bytes are a single VARIANT, whose text is the one of RAC
    #[arg(long, conflicts_with_all = ["variant", "com", "role"])]
    pub(crate) rac: bool,

    /// Frames have the CRC of a serial (COM) line
    #[arg(long, conflicts_with = "variant")]
    pub(crate) com: bool,

    /// The kind of the frames, which their bytes do not show
    #[arg(long = "as", value_name = "ROLE", default_value = "request", conflicts_with = "variant", value_parser = role())]
    pub(crate) role: Role,

    /// Converts JSON to bytes; with --rac, text to bytes, or to JSON with --json
    #[arg(long)]
    pub(crate) reverse: bool,

    /// Accepts common errors of peers: trailing bytes, counts and lengths that disagree, unknown types
    #[arg(long)]
    pub(crate) lenient: bool,

    #[command(flatten)]
    pub(crate) capture: CaptureArgs,

    /// The bytes, or the file of a capture; without it, or with `-`, the lines of the standard input
    #[arg(value_name = "HEX|FILE|JSON|TEXT")]
    pub(crate) words: Vec<String>,
}

/// The parts of a capture to show.
#[derive(Debug, Default, PartialEq, Args)]
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
    pub(crate) fn is_used(&self) -> bool {
        *self != Self::default()
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

/// Runs `bcap decode`.
pub(crate) fn decode(args: &Decode, json: bool) -> Result<(), Failure> {
    let strictness = if args.lenient { Strictness::Lenient } else { Strictness::Strict };
    if args.reverse {
        return reverse(args, json);
    }
    if let Some(file) = capture_file(&args.words) {
        if args.variant || args.com || args.rac {
            return Err(Failure::Input("--variant, --com and --rac do not apply to a capture".into()));
        }
        return decode_capture(file, &args.capture, strictness, json);
    }
    if args.capture.is_used() {
        let options = "--function, --object, --error, --from, --until, --csv and --stats";
        return Err(Failure::Input(format!("{options} need a capture: FILE.pcap, FILE.pcapng or FILE.cap")));
    }
    let decoder = Decoder { limits: LIMITS, strictness, crc: args.com };
    Items::from_words(&args.words).convert(json, |text, source| {
        let bytes = hex::parse(text)?;
        match source {
            _ if args.variant || args.rac => {
                let value = Variant::decode(&bytes, &LIMITS, strictness)?;
                Ok(match (args.rac, json) {
                    (true, true) => serde_json::json!({ "text": value::to_text(value)? }).to_string(),
                    (true, false) => escape::line(&value::to_text(value)?),
                    (false, true) => to_json(value),
                    (false, false) => format!("{value:?}"),
                })
            }
            ItemSource::Line => {
                let frame = decoder.decode_datagram(&bytes)?;
                Ok(if json { frame::to_json(&frame, args.role) } else { frame::to_line(&frame, args.role) })
            }
            ItemSource::Argument => all_frames(&bytes, decoder, args.role, json),
        }
    })
}

/// Converts JSON, or the text of RAC, to bytes.
fn reverse(args: &Decode, json: bool) -> Result<(), Failure> {
    if args.lenient || args.capture.is_used() {
        return Err(Failure::Input("--lenient and the options of captures do not apply to --reverse".into()));
    }
    Items::from_words(&args.words).convert(json && args.rac, |text, _| {
        let text = str::from_utf8(text).map_err(|e| ConvertError::new("the text is not UTF-8", e.valid_up_to()))?;
        if args.rac {
            let value = Value::parse_text(text.as_bytes())?;
            return Ok(if json { to_json(value.as_variant()) } else { hex::compact(value.as_bytes()) });
        }
        Ok(hex::compact(&if args.variant {
            json::parse_value(Part::whole(text))?
        } else {
            frame::from_json(text, args.role, args.com)?
        }))
    })
}

/// Decodes a sequence of frames, such as the capture of a stream.
fn all_frames(bytes: &[u8], decoder: Decoder, role: Role, json: bool) -> Result<String, ConvertError> {
    let is_lenient = decoder.strictness == Strictness::Lenient;
    let mut frames = Vec::new();
    frame::split(bytes, decoder, |bytes, frame| {
        frames.push(match json {
            true => frame::to_json(frame, role),
            // lenient decoding accepts wrong lengths, so bytes cannot be assigned to fields
            false if is_lenient => frame::to_line(frame, role),
            false => dissect(bytes, frame, role, decoder.crc),
        });
    })?;
    Ok(frames.join(if json || is_lenient { "\n" } else { "\n\n" }))
}

/// Returns the file that the words of `bcap decode` name; `None` if they are hexadecimal digits.
fn capture_file(words: &[String]) -> Option<&Path> {
    let [word] = words else { return None };
    let path = Path::new(word);
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    ["pcap", "pcapng", "cap"].iter().any(|known| extension.eq_ignore_ascii_case(known)).then_some(path)
}

fn decode_capture(path: &Path, args: &CaptureArgs, strictness: Strictness, json: bool) -> Result<(), Failure> {
    let filter = filter(args)?;
    let (events, read) = events(path, strictness);
    let began = events.first().map_or(0, Event::at);
    let print = if json { print_json } else { print_line };
    let format = if json { Format::Json } else { Format::Text };
    let accepted = events.iter().filter(|event| filter.accepts(event, began));
    let calls = accepted.clone().filter_map(|event| if let Event::Call(call) = event { Some(call) } else { None });
    if args.stats {
        let mut stats = Stats::default();
        calls.for_each(|call| stats.add(call));
        stats.lines(format).iter().try_for_each(|line| print(line))?;
    } else if args.csv {
        print_line(&csv::heading())?;
        calls.map(|call| csv::line(call, began)).try_for_each(|line| print_line(&line))?;
    } else {
        let printer = Printer::new(format, began);
        accepted.map(|event| printer.line(event)).try_for_each(|line| print(&line))?;
    }
    Ok(read?)
}

/// Returns the filter of the options.
fn filter(args: &CaptureArgs) -> Result<Filter, Failure> {
    let time = |seconds: f64| {
        Duration::try_from_secs_f64(seconds)
            .map_err(|_| Failure::Input(format!("{seconds} is not a time in seconds since the start of the capture")))
    };
    Ok(Filter {
        function: args.function.as_deref().map(function_name).transpose().map_err(Failure::Input)?,
        object: args.object.clone(),
        error: args.error.as_deref().map(str::parse).transpose().map_err(Failure::Input)?,
        from: args.from.map(time).transpose()?,
        until: args.until.map(time).transpose()?,
    })
}
