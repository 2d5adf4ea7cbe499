//! Writes settings into the configuration block of an image, ELF or binary, without rebuilding it.

use std::error::Error;
use std::path::Path;
use std::process::ExitCode;
use std::{env, fs};

use bcap_board::{Settings, image};

const USAGE: &str = "usage: configure IMAGE [KEY=VALUE | @FILE]...

Replaces the settings in an image; without settings as arguments, prints those of the image.
A file has one setting on each line, and may have empty lines and comments after #.";

fn main() -> ExitCode {
    let mut arguments = env::args().skip(1);
    let image = match arguments.next() {
        Some(image) if !image.starts_with('-') => image,
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match configure(Path::new(&image), &arguments.collect::<Vec<_>>()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("configure: {image}: {error}");
            ExitCode::FAILURE
        }
    }
}

fn configure(path: &Path, arguments: &[String]) -> Result<(), Box<dyn Error>> {
    let mut file = fs::read(path)?;
    if arguments.is_empty() {
        print!("{}", String::from_utf8_lossy(image::text(&file)?));
        return Ok(());
    }
    let settings = settings(arguments)?;
    image::write(&mut file, settings.as_bytes()).map_err(|error| error.to_string())?;
    Ok(fs::write(path, file)?)
}

/// Joins the settings, one on each line.
fn settings(arguments: &[String]) -> Result<String, String> {
    let mut settings = String::new();
    for argument in arguments {
        let file;
        // only files have comments; an argument may contain #
        let lines: Vec<_> = match argument.strip_prefix('@') {
            Some(path) => {
                file = fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
                Settings::lines_of_file(&file).collect()
            }
            None => argument.lines().filter(|line| !line.is_empty()).collect(),
        };
        for line in lines {
            settings.push_str(line);
            settings.push('\n');
        }
    }
    Ok(settings)
}
