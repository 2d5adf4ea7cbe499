//! tshark with the dissector that `bcap generate wireshark` prints.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::LazyLock;

use bcap_tests::tools;

/// The output of `bcap generate wireshark`.
pub(crate) static DISSECTOR: LazyLock<String> = LazyLock::new(|| {
    let run = crate::common::bcap(&["generate", "wireshark"]);
    assert_eq!((run.code, run.err.as_str()), (0, ""));
    run.out
});

/// Returns whether this machine has tshark; if not, the test says that it is skipped.
pub(crate) fn has_tshark() -> bool {
    tools::find("tshark").is_some()
}

/// Runs tshark with the dissector alone, without the user's settings, and returns its output.
pub(crate) fn tshark(capture: &Path, args: &[&str]) -> String {
    let home = tempfile::tempdir().unwrap();
    let script = home.path().join("bcap.lua");
    fs::write(&script, DISSECTOR.as_str()).unwrap();
    let output = Command::new("tshark")
        .args(["-n", "-2", "-r"])
        .arg(capture)
        .arg(format!("-Xlua_script:{}", script.display()))
        .args(args)
        .env("HOME", home.path())
        .env("XDG_CONFIG_HOME", home.path())
        .env("TZ", "UTC")
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !err.contains("Lua"), "{err}");
    String::from_utf8(output.stdout).map_err(|error| error.utf8_error()).expect("text of tshark in UTF-8")
}

/// The packets that a display filter selects.
pub(crate) fn selected(capture: &Path, filter: &str) -> usize {
    tshark(capture, &["-Y", filter, "-T", "fields", "-e", "frame.number"]).lines().count()
}
