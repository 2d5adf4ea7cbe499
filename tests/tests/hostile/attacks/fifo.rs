//! A FIFO in the folder of the virtual controller.

use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use bcap_core::bcap::call;
use bcap_sim::{Controller, Profile};
use bcap_std::{Options, blocking};
use bcap_testkit::value::Value;
use bcap_tests::served::Served;
use bcap_tests::tools;

use crate::script::Outcome;
use crate::target::{Target, limits};

/// Reading and writing it fails immediately, and other clients are served in the meantime.
pub(super) fn a_fifo_among_the_files(_: &mut Target) {
    let folder = std::env::temp_dir().join(format!("bcap-fifo-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let fifo = folder.join("pipe");
    if !Command::new("mkfifo").arg(&fifo).status().is_ok_and(|status| status.success()) {
        return tools::missing("there is no mkfifo");
    }
    let config = bcap_sim::Config { files: Some(folder.clone()), ..bcap_sim::Config::new(Profile::Rc8) };
    let served = Served::of(Controller::new(config), limits());
    let outcomes: BTreeMap<_, _> =
        [("reading", false), ("writing", true)].map(|(n, w)| (n, touches(&served, w))).into();
    // a server that waits in the FIFO must end too: the other end is opened, and closed immediately
    let stopped = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            while !stopped.load(Ordering::Relaxed) {
                drop(OpenOptions::new().read(true).write(true).open(&fifo));
                thread::sleep(Duration::from_millis(10));
            }
        });
        drop(served);
        stopped.store(true, Ordering::Relaxed);
    });
    fs::remove_dir_all(folder).unwrap();
    for (what, (touched, other)) in outcomes {
        assert!(matches!(touched, Outcome::Refused(_)), "{what} a FIFO: {touched:?}");
        assert!(matches!(other, Outcome::Value(_)), "another client after {what} a FIFO: {other:?}");
    }
}

/// Reads or writes the FIFO, and then calls as another client.
fn touches(served: &Served<Controller>, writes: bool) -> (Outcome, Outcome) {
    let options = Options::default().timeout(Duration::from_secs(5));
    let connect = || {
        let mut client = blocking::connect_tcp(served.tcp, &options).unwrap();
        let started = client.call(call::service_start(""));
        started.and_then(|()| {
            let controller = client.call(call::controller_connect("", Profile::Rc8.provider(), "localhost", ""))?;
            Ok((client, controller))
        })
    };
    let touched = connect().and_then(|(mut client, controller)| {
        let file = client.call(call::controller_get_file(controller, "pipe", ""))?;
        if writes {
            client.call(call::file_put_value(file, "text"))?;
            return Ok(Value::Empty);
        }
        client.call(call::file_get_value(file)).map(Value::read)
    });
    let other = connect().and_then(|(mut client, controller)| {
        let mode = client.call(call::controller_get_variable(controller, "@MODE", ""))?;
        client.call(call::variable_get_value(mode)).map(Value::read)
    });
    (touched.into(), other.into())
}
