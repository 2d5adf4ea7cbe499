//! Tests the protocol that changes settings over a serial line.

use std::convert::Infallible;

use bcap_board::console::{Action, Console, LINE};
use bcap_board::crc::Crc32;
use bcap_board::slots::{Slots, TEXT};
#[cfg(feature = "health")]
use bcap_board::{SettingError, Settings, console::NotSaved};
use bcap_testkit::flash::Flash;

const IMAGE: &[u8] = b"robot=192.168.0.1:5007\nput=I/0-9\n\0\0\0\0";

type Board = Console<'static, Flash<4, 2048>>;

fn board() -> Board {
    Console::new(Slots::new(Flash::new(4096), 0..4096).unwrap(), IMAGE)
}

/// Sends bytes and returns the answers.
fn send(board: &mut Board, bytes: &[u8]) -> String {
    let mut port = Port::default();
    for byte in bytes {
        assert_eq!(board.receive(*byte, &mut port), Ok(None));
    }
    String::from_utf8(port.0).unwrap()
}

/// The bytes that the board sent.
#[derive(Default)]
struct Port(Vec<u8>);

impl embedded_io::ErrorType for Port {
    type Error = Infallible;
}

impl embedded_io::Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        // a port may take a part only
        let count = bytes.len().min(3);
        self.0.extend(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

fn crc(text: &str) -> String {
    format!("{:08x}", Crc32::new().and(text.as_bytes()).value())
}

#[test]
fn settings_are_saved_shown_and_removed() {
    let mut board = board();
    assert_eq!(send(&mut board, b"hello\r\n"), "ok bcap-board 1\n");
    let of_image = "setting robot=192.168.0.1:5007\nsetting put=I/0-9\nok image\n";
    assert_eq!(send(&mut board, b"show\n"), of_image);
    assert_eq!(send(&mut board, b"new\nadd put=I/0-99\nadd hostname=cell-7\n"), "ok\nok\nok\n");
    let saved = crc("put=I/0-99\nhostname=cell-7\n");
    assert_eq!(send(&mut board, format!("save {saved}\n").as_bytes()), "ok\n");
    assert_eq!(send(&mut board, b"show\n"), "setting put=I/0-99\nsetting hostname=cell-7\nok flash\n");
    assert_eq!(send(&mut board, b"factory\nshow\n"), ["ok\n", of_image].concat());
}

#[test]
fn invalid_requests_are_answered_and_change_nothing() {
    let mut board = board();
    for (request, answer) in [
        (
            "add put=I/3-1",
            "error invalid setting \"put=I/3-1\": invalid index range 3-1: the first index is above the last, at column 7",
        ),
        ("add colour=red", "error invalid setting \"colour=red\": expected KEY=VALUE with a known key, at column 1"),
        ("add", "error add needs KEY=VALUE"),
        ("add machine=a\0b", "error invalid setting \"machine=a\\x00b\": a setting cannot contain NUL, at column 10"),
        ("save 1", "error the settings have the CRC-32 00000000"),
        ("save", "error the settings have the CRC-32 00000000"),
        ("Hello", "error unknown request \"Hello\""),
        ("\u{7}", "error unknown request \"\\u{7}\""),
    ] {
        assert_eq!(send(&mut board, format!("{request}\n").as_bytes()), format!("{answer}\n"), "{request:?}");
    }
    assert_eq!(send(&mut board, b"\xff\xfe\n"), "error the request is not UTF-8\n");
    assert_eq!(send(&mut board, b"\n\r\n\r"), "", "empty lines");
    assert_eq!(send(&mut board, &[b'x'; LINE]), "");
    assert_eq!(send(&mut board, b"\n").len(), "error unknown request \"\"\n".len() + LINE, "the longest request");
    assert_eq!(
        send(&mut board, &[&[b'x'; LINE + 1][..], b"\nhello\n"].concat()),
        "error the request is longer than 512 bytes\nok bcap-board 1\n"
    );
    // refused lines are not a part of the new settings
    assert_eq!(send(&mut board, b"save 00000000\nshow\n"), "ok\nok flash\n");
}

#[test]
fn settings_beyond_the_memory_are_refused() {
    let mut board = board();
    let line = format!("add provider={}\n", "x".repeat(TEXT / 5 - 10));
    let answers = send(&mut board, line.repeat(6).as_bytes());
    assert_eq!(answers, "ok\n".repeat(5) + &format!("error the settings take {} bytes of {TEXT}\n", TEXT / 5 * 6));
    let rules = send(&mut board, ["new\n", &"add put=I\n".repeat(33)].concat().as_bytes());
    assert!(rules.starts_with(&"ok\n".repeat(33)) && rules.contains("too many rules"), "{rules}");
}

#[test]
fn a_setting_is_shown_complete_however_long_it_is() {
    for len in [240, 247, 248, 249, 255, 256, 257, 480] {
        let (mut board, line) = (board(), format!("provider={}", "x".repeat(len)));
        send(&mut board, format!("new\nadd {line}\nadd put=I\n").as_bytes());
        let saved = crc(&format!("{line}\nput=I\n"));
        assert_eq!(send(&mut board, format!("save {saved}\n").as_bytes()), "ok\n");
        assert_eq!(send(&mut board, b"show\n"), format!("setting {line}\nsetting put=I\nok flash\n"), "{len}");
    }
    // a line without a line feed, and empty lines
    let mut board = Console::new(Slots::new(Flash::new(4096), 0..4096).unwrap(), b"\n\nput=I\n\nput=F");
    assert_eq!(send(&mut board, b"show\n"), "setting put=I\nsetting put=F\nok image\n");
}

#[test]
fn a_restart_is_an_action_after_its_answer() {
    let mut port = Port::default();
    let mut board = board();
    let last = b"restart\n".iter().map(|byte| board.receive(*byte, &mut port).unwrap()).last();
    assert_eq!((last, port.0), (Some(Some(Action::Restart)), b"ok\n".to_vec()));
}

#[cfg(feature = "health")]
fn running(text: &str) -> Settings<'_> {
    Settings::read(text.as_bytes(), |line, error| panic!("{}: {error}", line.escape_ascii()))
}

#[cfg(feature = "health")]
#[test]
fn a_page_replaces_the_settings_and_keeps_the_password() {
    let mut board = board();
    let text = "health=80\npassword=12345678\nput=I/0-9\nallow=10.0.0.0/8\n";
    let page = "# line 3\r\n \r\n health=80\r\nallow=10.0.0.0/8\r\n  # more\r\nput=I/0-99=-10..10\r\nhostname=cell-7";
    assert_eq!(board.replace(page, &running(text)), Ok(()));
    let shown = send(&mut board, b"show\n");
    let expected = "setting password=12345678\nsetting health=80\nsetting allow=10.0.0.0/8\nsetting put=I/0-99=-10..10\n\
                    setting hostname=cell-7\nok flash\n";
    assert_eq!(shown, expected);
    // the board runs with other settings until it restarts
    assert_eq!(board.replace(page, &running(text)), Err(NotSaved::Changed));
    assert_eq!(send(&mut board, b"show\n"), expected);
}

#[cfg(feature = "health")]
#[test]
fn values_that_a_page_sends_back_are_not_shortened() {
    let mut board = board();
    let text = "health=80\npassword=12345678\noption=a #b\nmachine= m \n";
    assert_eq!(board.replace("health=80\r\noption=a #b\r\nmachine= m \r\n", &running(text)), Ok(()));
    let shown = send(&mut board, b"show\n");
    let expected = "setting password=12345678\nsetting health=80\nsetting option=a #b\nsetting machine= m \nok flash\n";
    assert_eq!(shown, expected);
}

#[cfg(feature = "health")]
#[test]
fn settings_of_a_page_that_are_not_saved_change_nothing() {
    let mut board = board();
    let text = "health=80\npassword=12345678\n";
    let line = |number, column, error| Err(NotSaved::Line { number, column, error });
    let long = "provider=".to_owned() + &"x".repeat(TEXT / 2) + "\n";
    for (page, expected) in [
        ("health=80\n\nput=X", line(3, 5, SettingError::Rule(rule("X")))),
        ("health=80\ncolour=red", line(2, 1, SettingError::Key)),
        ("health=80\nhealth", line(2, 1, SettingError::Key)),
        ("health=80\nmachine=a\0b", line(2, 10, SettingError::Nul)),
        ("health=80\nmodbus=80", line(2, 8, SettingError::Port)),
        ("health=80\nput=I # more", line(2, 5, SettingError::Rule(rule("I # more")))),
        ("health=80\npassword=abcdefgh", Err(NotSaved::Secret { number: 2 })),
        ("health=80\n PASSWORD=abcdefgh", Err(NotSaved::Secret { number: 2 })),
        ("passphrase=abcdefgh", Err(NotSaved::Secret { number: 1 })),
        ("", Err(NotSaved::Reach)),
        ("health=8080", Err(NotSaved::Reach)),
        ("health=80\nallow=10.0.0.7", Err(NotSaved::Reach)),
        ("health=80\nreach=no", line(2, 1, SettingError::Key)),
        (&[&long[..], &long].concat(), Err(NotSaved::TooLong)),
        (&"put=I\n".repeat(33), line(33, 1, SettingError::TooManyRules)),
    ] {
        assert_eq!(board.replace(page, &running(text)), expected, "{page:?}");
        let shown = send(&mut board, b"show\n");
        assert_eq!(shown, "setting robot=192.168.0.1:5007\nsetting put=I/0-9\nok image\n", "{page:?}");
    }
    // a host that changes the settings at the same time cannot save a mixture
    assert_eq!(send(&mut board, b"new\nadd put=F\n"), "ok\nok\n");
    assert_eq!(board.replace("put=X", &running(text)), line(1, 5, SettingError::Rule(rule("X"))));
    let saved = send(&mut board, format!("save {}\n", crc("put=F\n")).as_bytes());
    assert!(saved.starts_with("error the settings have the CRC-32 "), "{saved}");
    // intended
    assert_eq!(board.replace("reach=yes\nhealth=8080", &running(text)), Ok(()));
    assert_eq!(send(&mut board, b"show\n"), "setting password=12345678\nsetting health=8080\nok flash\n");
    assert_eq!(send(&mut board, b"factory\n"), "ok\n");
    assert_eq!(board.replace("health=80", &running(text)), Err(NotSaved::Changed));
}

/// Returns the fault of an invalid rule.
#[cfg(feature = "health")]
fn rule(text: &str) -> bcap_gateway::RuleError {
    bcap_gateway::AllowBuf::parse(text).unwrap_err()
}
