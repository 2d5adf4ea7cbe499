//! The command `configure`, on files that stand for images.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, process};

use bcap_board::{BLOCK, MAGIC};

/// A file that is removed when the test is over.
struct Temporary(PathBuf);

impl Temporary {
    fn new(name: &str, bytes: &[u8]) -> Self {
        let path = env::temp_dir().join(format!("bcap-configure-{}-{name}", process::id()));
        fs::write(&path, bytes).unwrap();
        Self(path)
    }

    fn image(name: &str) -> Self {
        let block = [MAGIC.as_slice(), &[0; BLOCK - MAGIC.len()]].concat();
        Self::new(name, &[[0x55; 100].as_slice(), &block, &[0xaa; 100]].concat())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

/// Runs the command; returns what it printed, what it complained of, and its exit code.
fn configure(image: &Path, settings: &[&str]) -> (String, String, i32) {
    let output = Command::new(env!("CARGO_BIN_EXE_configure")).arg(image).args(settings).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (text(output.stdout), text(output.stderr), output.status.code().unwrap())
}

#[test]
fn settings_are_written_and_shown() {
    let image = Temporary::image("written");
    let before = fs::read(&image.0).unwrap();
    assert_eq!(configure(&image.0, &[]), (String::new(), String::new(), 0));
    let file = Temporary::new("settings", b"# a robot\nrobot=udp:10.0.0.1:5007   # over UDP\n\nput=I/0-9=-1..1\n");
    let from_file = format!("@{}", file.0.display());
    assert_eq!(configure(&image.0, &["service=WDT=400 # as it is", &from_file]).2, 0);
    let shown = "service=WDT=400 # as it is\nrobot=udp:10.0.0.1:5007\nput=I/0-9=-1..1\n";
    assert_eq!(configure(&image.0, &[]), (shown.to_owned(), String::new(), 0));
    let after = fs::read(&image.0).unwrap();
    assert_eq!(after.len(), before.len());
    assert_eq!((&after[..108], &after[100 + BLOCK..]), (&before[..108], &before[100 + BLOCK..]));
}

#[test]
fn invalid_settings_are_refused() {
    let image = Temporary::image("refused");
    let before = fs::read(&image.0).unwrap();
    for (settings, complaint) in [
        (["echo=7", "put=X"], "invalid setting \"put=X\": unknown kind of variable"),
        (["echo=7", "nonsense"], "invalid setting \"nonsense\": expected KEY=VALUE"),
        (["echo=7", "@/no/such/file"], "/no/such/file"),
    ] {
        let (out, err, code) = configure(&image.0, &settings);
        assert_eq!((out.as_str(), code), ("", 1));
        assert!(err.contains(complaint) && err.contains("refused"), "{err}");
    }
    assert_eq!(fs::read(&image.0).unwrap(), before);
    let none = Temporary::new("none", &[0x55; 4096]);
    let (_, err, code) = configure(&none.0, &["echo=7"]);
    assert!(code == 1 && err.contains("no configuration block"), "{err}");
    let (_, err, code) = configure(Path::new("--help"), &[]);
    assert!(code == 2 && err.contains("usage"), "{err}");
}
