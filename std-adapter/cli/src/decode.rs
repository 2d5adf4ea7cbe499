//! `bcap decode` and `bcap encode`: convert captures, frames and values between their bytes and text or JSON.

use std::path::Path;
use std::str;
use std::time::Duration;

use bcap_capture::decode::{Event, Filter, Format, Printer, Stats, csv, events, function_name};
use bcap_capture::dissect::dissect;
use bcap_capture::json::{self, LIMITS, Part};
use bcap_capture::value::to_json;
use bcap_capture::{ConvertError, Role, frame, hex};
use bcap_core::bcap::Decoder;
use bcap_core::limits::Strictness;
use bcap_core::variant::Variant;

use crate::args::{CaptureArgs, Decode, Encode};
use crate::error::Failure;
use crate::input::{Items, Source};
use crate::output::{print_json, print_line};

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

/// Runs `bcap encode`.
pub(crate) fn encode(args: &Encode) -> Result<(), Failure> {
    Items::from_words(&args.line).convert(false, |text, _| {
        let text =
            str::from_utf8(text).map_err(|error| ConvertError::new("the text is not UTF-8", error.valid_up_to()))?;
        let bytes = if args.form.variant {
            json::parse_value(Part::whole(text))?
        } else {
            frame::from_json(text, args.form.role, args.form.com)?
        };
        Ok(hex::compact(&bytes))
    })
}
