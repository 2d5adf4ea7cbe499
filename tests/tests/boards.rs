//! The scripts of the images for boards refuse wrong arguments before they build anything.

use std::path::Path;
use std::process::Command;

/// Runs a script of `embassy-adapter/boards`, and returns its exit code and its error output.
fn run(script: &str, arguments: &[&str]) -> (Option<i32>, String) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../embassy-adapter/boards").join(script);
    let output = Command::new(path).args(arguments).output().unwrap();
    assert!(output.stdout.is_empty(), "{output:?}");
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn no_project_is_made_for_a_board_that_does_not_exist() {
    let folder = tempfile::tempdir().unwrap();
    let project = folder.path().join("gateway");
    for board in [
        "",
        ".*",
        "pico",
        "w5500.evb.pico",
        "../boards/w5500-evb-pico",
        "w5500-evb-pico+updates",
        "w5500-evb-pico-boot",
    ] {
        let (code, error) = run("new", &[board, project.to_str().unwrap()]);
        let expected = format!(
            "new: there is no board {board}; the boards are: w5500-evb-pico w5500-evb-pico2 nucleo-h743zi2 nucleo-h563zi nucleo-f429zi \
             esp32c3-w5500 esp32c6-wifi\n"
        );
        assert_eq!((code, error), (Some(2), expected));
    }
    assert!(!project.exists());
}

#[test]
fn no_project_has_an_invalid_name() {
    let folder = tempfile::tempdir().unwrap();
    for name in [".*", "Line3", "3line", "line 3", "line.3", "-line", "line\n3", "line|3"] {
        let project = folder.path().join(name);
        let (code, error) = run("new", &["w5500-evb-pico", project.to_str().unwrap()]);
        let expected =
            format!("new: invalid project name \"{name}\": use a-z, 0-9, - and _, and begin with a letter\n");
        assert_eq!((code, error), (Some(2), expected));
        assert!(!project.exists());
    }
    // a nested folder has the name of its last part, even at the root
    let (code, error) = run("new", &["w5500-evb-pico", "/"]);
    assert_eq!(code, Some(2));
    assert!(error.starts_with("new: invalid project name \"/\""), "{error}");
    let (code, error) = run("new", &["w5500-evb-pico", "-line"]);
    assert_eq!(code, Some(2));
    assert!(error.starts_with("new: invalid project name \"-line\""), "{error}");
    let existing = folder.path().to_str().unwrap().to_owned() + "/line";
    std::fs::create_dir(&existing).unwrap();
    assert_eq!(run("new", &["w5500-evb-pico", &existing]), (Some(2), format!("new: {existing} exists\n")));
}

#[test]
fn no_board_is_built_that_does_not_exist() {
    for board in ["", ".*", "pico", "w5500-evb-pic", "esp32c3-w5500 "] {
        let expected = format!("there is no board \"{board}\"; targets lists them\n");
        assert_eq!(run("build", &[board]), (Some(2), expected));
    }
}
