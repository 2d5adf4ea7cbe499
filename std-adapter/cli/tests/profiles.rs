//! Profiles and environment variables of the connection, and their precedence.

use std::fs;
use std::path::PathBuf;

use crate::common::fake::{Fake, usual, value};
use crate::common::robot::Robot;
use crate::common::{Run, bare};
use bcap_core::bcap::FunctionId;

/// A folder with a file of profiles.
struct Home {
    folder: tempfile::TempDir,
    file: PathBuf,
}

impl Home {
    fn with(text: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("bcap").join("config.toml");
        fs::create_dir(folder.path().join("bcap")).unwrap();
        fs::write(&file, text).unwrap();
        Self { folder, file }
    }

    fn run(&self, args: &[&str], environment: &[(&str, &str)]) -> Run {
        let mut command = bare(args);
        command.env("XDG_CONFIG_HOME", self.folder.path()).envs(environment.iter().copied());
        command.output().unwrap().into()
    }
}

fn fake() -> Fake {
    Fake::tcp(|request| match request.function() {
        FunctionId::VARIABLE_GET_VALUE => value(1),
        _ => usual(request),
    })
}

#[test]
fn option_environment_profile_default_in_this_order() {
    let [one, two, three] = [fake(), fake(), fake()];
    let home = Home::with(&format!(
        "[profile.cell]\naddress = \"{}\"\nmodel = \"rc9\"\noption = \"@IfNotMember\"\ntimeout = \"20s\"\n",
        one.address
    ));
    let connected = |fake: &Fake| fake.seen().iter().find(|call| call.starts_with("ControllerConnect")).cloned();
    let connect = |provider: &str, option: &str| {
        // the machine of an RC9 is its address
        let machine = if provider.ends_with("VRC9") { "127.0.0.1" } else { "localhost" };
        Some(format!("ControllerConnect(\"\", \"{provider}\", \"{machine}\", \"{option}\")"))
    };
    let run = home.run(&["get", "I1", "--profile", "cell"], &[]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 1\n", 0), "{run:?}");
    assert_eq!(connected(&one), connect("CaoProv.DENSO.VRC9", "@IfNotMember"));

    let environment = [
        ("BCAP_PROFILE", "cell"),
        ("BCAP_ROBOT", two.address.as_str()),
        ("BCAP_PROVIDER", "FromEnvironment"),
        ("BCAP_OPTION", "E=1"),
        ("BCAP_TIMEOUT", "15s"),
    ];
    assert_eq!(home.run(&["get", "I1"], &environment).code, 0);
    assert_eq!(connected(&two), connect("FromEnvironment", "E=1"));

    let options = ["--robot", &three.address, "--provider", "FromOption", "--option", "O=1"];
    assert_eq!(home.run(&[&["get", "I1"], &options[..]].concat(), &environment).code, 0);
    assert_eq!(connected(&three), connect("FromOption", "O=1"));
    assert_eq!([one.seen().len(), two.seen().len(), three.seen().len()], [7, 7, 7]);

    let run = home.run(&["get", "I1", "--robot", &one.address], &[]);
    assert_eq!(run.code, 0);
    assert!(one.seen()[7..].contains(&connect("CaoProv.DENSO.VRC", "").unwrap()), "{:?}", one.seen());
    // an empty variable chooses no profile
    assert_eq!(home.run(&["get", "I1", "--robot", &one.address], &[("BCAP_PROFILE", "")]).code, 0);
}

#[test]
fn a_timeout_of_the_profile_or_the_environment_applies() {
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp:{}", silent.local_addr().unwrap());
    let home = Home::with(&format!("[profile.cell]\naddress = \"{address}\"\ntimeout = \"600ms\"\n"));
    let run = home.run(&["get", "I1", "--profile", "cell"], &[]);
    assert!(run.code == 4 && run.err.contains("time limit of 600 ms"), "{run:?}");
    let run = home.run(&["get", "I1", "--profile", "cell"], &[("BCAP_TIMEOUT", "500")]);
    assert!(run.code == 4 && run.err.contains("time limit of 500 ms"), "{run:?}");
    let run = home.run(&["get", "I1", "--profile", "cell", "--timeout", "400"], &[("BCAP_TIMEOUT", "500")]);
    assert!(run.code == 4 && run.err.contains("time limit of 400 ms"), "{run:?}");
    let run = home.run(&["get", "I1", "--robot", &address], &[("BCAP_TIMEOUT", "soon")]);
    assert!(run.code == 2 && run.err.contains("soon"), "{run:?}");
}

#[test]
fn rac_uses_the_host_of_the_profile_and_its_own_port() {
    let robot = Robot::start();
    robot.set(bcap_core::rac::VariableKind::I, 1, &bcap_core::variant::Variant::I4(42));
    let (address, port) = (&robot.tcp, robot.served.rac.port());
    let home = Home::with(&format!("[profile.cell]\naddress = \"{address}\"\nrac_port = {port}\n"));
    let run = home.run(&["--profile", "cell", "rac", "get", "I1"], &[]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 42\n", 0), "{run:?}");
    let run = home.run(&["rac", "get", "I1"], &[("BCAP_ROBOT", address), ("BCAP_RAC_PORT", &port.to_string())]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 42\n", 0), "{run:?}");
}

#[test]
fn a_wrong_profile_is_named_with_file_and_line() {
    let home = Home::with("[profile.cell]\naddress = \"tcp:x\"\n\n[profile.other]\nmodell = \"rc8\"\n");
    let run = home.run(&["get", "I1", "--profile", "cell"], &[]);
    let place = format!("{}, line 5: unknown field `modell`", home.file.display());
    assert!(run.code == 2 && run.err.contains(&place), "{run:?}");
    // a command that does not connect does not read the file
    assert_eq!(home.run(&["decode", "--rac", "--reverse", "3,1"], &[("BCAP_PROFILE", "cell")]).code, 0);

    let home = Home::with("[profile.cell]\naddress = \"tcp:x\"\n[profile.b]\n");
    let run = home.run(&["get", "I1"], &[("BCAP_PROFILE", "cel")]);
    assert!(run.code == 2 && run.err.contains("the profile cel does not exist; "), "{run:?}");
    assert!(run.err.contains("has b, cell"), "{run:?}");
}

#[test]
fn a_wrong_profile_does_not_prevent_a_halt() {
    let robot = Robot::start();
    let home = Home::with("[profile.cell");
    let run = home.run(&["halt", "--timeout", "30s", "--robot", &robot.tcp], &[("BCAP_PROFILE", "cell")]);
    assert_eq!((run.out.as_str(), run.code), ("nothing was moving\n", 0), "{run:?}");
    assert!(run.err.contains("config.toml, line 1: "), "{run:?}");
    assert_eq!(home.run(&["halt"], &[("BCAP_PROFILE", "cell")]).code, 2);
    // the time limit of a halt stays 3 s
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap();
    let home = Home::with(&format!("[profile.cell]\naddress = \"{address}\"\ntimeout = \"1min\"\n"));
    let run = home.run(&["halt", "--profile", "cell"], &[]);
    assert!(run.code == 4 && run.err.contains("time limit of 3000 ms"), "{run:?}");
}

#[test]
fn profiles_are_listed_and_shown() {
    let home = Home::with(
        "[profile.cell]\naddress = \"192.168.0.1\"\nmodel = \"cobotta\"\nrac_port = 5016\ntimeout = \"2s\"\n[profile.a]\n",
    );
    assert_eq!(home.run(&["profile", "list"], &[]).out, "a: no address\ncell: 192.168.0.1\n");
    let shown = "[profile.cell]\naddress = \"192.168.0.1\"\nprovider = \"CaoProv.DENSO.VRC\"\nrac_port = 5016\n\
                 timeout = \"2000ms\"\n";
    assert_eq!(home.run(&["profile", "show", "cell"], &[]).out, shown);
    let json = home.run(&["profile", "show", "cell", "--json"], &[]).out;
    assert!(json.contains("\"timeout_ms\":2000") && json.contains("\"option\":null"), "{json}");
    let run = home.run(&["profile", "show", "x"], &[]);
    assert!(run.code == 2 && run.err.contains("has a, cell"), "{run:?}");
    let empty = Home::with("");
    assert!(empty.run(&["profile", "list"], &[]).out.ends_with("config.toml has no profiles\n"));
    fs::remove_file(&empty.file).unwrap();
    let run = empty.run(&["get", "I1", "--profile", "x"], &[]);
    assert!(run.code == 2 && run.err.contains("write [profile.x] there"), "{run:?}");
}

#[test]
fn the_name_of_a_model_is_a_provider_and_a_profile_remembers_it() {
    let fake = fake();
    for (name, provider) in [("RC9", "VRC9"), ("cobotta-pro", "VRC9"), ("rc8", "VRC"), ("cobotta", "VRC")] {
        assert_eq!(
            bare(&["get", "I1", "--robot", &fake.address, "--provider", name]).output().unwrap().status.code(),
            Some(0)
        );
        let connect = fake.seen().into_iter().rfind(|call| call.starts_with("ControllerConnect")).unwrap();
        assert!(connect.contains(&format!("\"CaoProv.DENSO.{provider}\"")), "{name}: {connect}");
    }
    let rc9 = Robot::with(bcap_sim::Config::new(bcap_sim::Profile::Rc9));
    let text = format!("# the cells\n[profile.cell]\naddress = \"{}\"\n[profile.b]\n", rc9.tcp);
    let home = Home::with(&text);
    let run = home.run(&["get", "I1", "--profile", "cell"], &[]);
    assert_eq!((run.out.as_str(), run.code), ("I1 = 0\n", 0), "{run:?}");
    assert!(run.err.contains("note: the profile cell connects to CaoProv.DENSO.VRC9"), "{run:?}");
    let line = "[profile.cell]\nprovider = \"CaoProv.DENSO.VRC9\"\n";
    assert_eq!(fs::read_to_string(&home.file).unwrap(), text.replace("[profile.cell]\n", line));
    let run = home.run(&["get", "I1", "--profile", "cell"], &[]);
    assert_eq!((run.out.as_str(), run.err.as_str()), ("I1 = 0\n", ""));
    // a profile that is written in another way stays unchanged, and so does the profile of another address
    let text = format!("profile.cell = {{ address = \"{}\" }}\n", rc9.tcp);
    let home = Home::with(&text);
    let run = home.run(&["get", "I1", "--profile", "cell"], &[]);
    assert!(
        run.code == 0 && run.err.contains("note: write provider = \"CaoProv.DENSO.VRC9\" in the profile cell"),
        "{run:?}"
    );
    assert_eq!(home.run(&["get", "I1", "--profile", "cell", "--robot", &rc9.tcp], &[]).err, "");
    assert_eq!(fs::read_to_string(&home.file).unwrap(), text);
}
