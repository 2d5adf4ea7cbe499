//! `bcap decode` and `bcap encode`: convert captures, frames and values between their bytes and text or JSON.

use std::path::Path;
use std::str;
use std::time::Duration;

use bcap_capture::decode::{Event, Filter, Format, Printer, Stats, csv, events, function_name};
use bcap_capture::dissect::dissect;
use bcap_capture::json::LIMITS;
use bcap_capture::value::to_json;
use bcap_capture::{ConvertError, Role, frame, hex};
use bcap_core::bcap::Decoder;
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::commands::packets::items::{Items, Source};
use crate::failure::Failure;
use crate::output::{print_json, print_line};

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
    if let Some(file) = capture_file(&args.hex) {
        if args.form.variant || args.form.com {
            return Err(Failure::Input("--variant and --com do not apply to a capture".into()));
        }
        return decode_capture(file, &args.capture, strictness, json);
    }
    if args.capture.is_used() {
        let options = "--function, --object, --error, --from, --until, --csv and --stats";
        return Err(Failure::Input(format!("{options} need a capture: FILE.pcap, FILE.pcapng or FILE.cap")));
    }
    let decoder = Decoder { limits: LIMITS, strictness, crc: args.form.com };
    Items::from_words(&args.hex).convert(json, |text, source| {
        let bytes = hex::parse(text)?;
        match source {
            _ if args.form.variant => {
                let value = Variant::decode(&bytes, &LIMITS, strictness)?;
                Ok(if json { to_json(value) } else { format!("{value:?}") })
            }
            Source::Line => {
                let frame = decoder.decode_datagram(&bytes)?;
                Ok(if json { frame::to_json(&frame, args.form.role) } else { frame::to_line(&frame, args.form.role) })
            }
            Source::Argument => all_frames(&bytes, decoder, args.form.role, json),
        }
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
