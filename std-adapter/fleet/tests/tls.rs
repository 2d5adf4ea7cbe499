//! An encrypted connection to a real Mosquitto that demands a client certificate, user and password.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::common::{Robot, Running};
use bcap_fleet::Config;
use bcap_tests::mosquitto::Mosquitto;
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair};

/// Writes an authority, and certificates of a broker and a client.
fn certificates(folder: &Path) {
    let mut params = CertificateParams::new(vec![]).unwrap();
    // the subjects must differ, or the certificates look self-signed
    params.distinguished_name.push(DnType::CommonName, "authority");
    params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    let ca = CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap();
    fs::write(folder.join("ca.pem"), ca.pem()).unwrap();
    for (name, host) in [("broker", "localhost"), ("client", "edge1")] {
        let key = KeyPair::generate().unwrap();
        let mut params = CertificateParams::new(vec![host.to_owned()]).unwrap();
        params.distinguished_name.push(DnType::CommonName, host);
        let certificate = params.signed_by(&key, &ca).unwrap();
        fs::write(folder.join(format!("{name}.pem")), certificate.pem()).unwrap();
        fs::write(folder.join(format!("{name}.key")), key.serialize_pem()).unwrap();
    }
    fs::write(folder.join("password"), "secret of the test\n").unwrap();
    let passwords = folder.join("passwords");
    fs::write(&passwords, "edge1:secret of the test\n").unwrap();
    // hashes the passwords in place
    let done = std::process::Command::new("mosquitto_passwd").arg("-U").arg(&passwords).status().unwrap();
    assert!(done.success());
}

fn config(port: u16, folder: &Path, robot: &Robot) -> String {
    let path = |name: &str| folder.join(name).display().to_string();
    format!(
        "group = \"plant\"\nnode = \"edge1\"\n[broker]\nhost = \"localhost\"\nport = {port}\nuser = \"edge1\"\n\
         password_file = \"{}\"\n[broker.tls]\nca = \"{}\"\ncertificate = \"{}\"\nkey = \"{}\"\n\
         [[controller]]\nname = \"cell1\"\naddress = \"tcp:{}\"\n[[controller.publish]]\nnames = [\"I1\", \"I2-3\"]\n",
        path("password"),
        path("ca.pem"),
        path("client.pem"),
        path("client.key"),
        robot.address
    )
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_certificate_and_a_password_are_needed() {
    let broker = Mosquitto::start(|folder| {
        certificates(folder);
        let path = |name: &str| folder.join(name).display().to_string();
        format!(
            "cafile {}\ncertfile {}\nkeyfile {}\nrequire_certificate true\npassword_file {}\n",
            path("ca.pem"),
            path("broker.pem"),
            path("broker.key"),
            path("passwords")
        )
    });
    let Some(broker) = broker else { return };
    let robot = Robot::start().await;
    robot.set(1, 3);
    let good = config(broker.port, broker.path(), &robot);
    // the broker may still be starting
    let rows = loop {
        let rows = bcap_fleet::check(&Config::parse(&good).unwrap()).await.unwrap();
        match &rows[0].result {
            Err(reason) if reason.contains("refused") => tokio::time::sleep(std::time::Duration::from_millis(5)).await,
            _ => break rows,
        }
    };
    assert!(rows.iter().all(|row| row.result.is_ok()), "{rows:?}");
    assert_eq!((rows.len(), rows[2].what.as_str(), rows[2].result.as_ref().unwrap().0.as_str()), (5, "I1", "3"));

    let without: String =
        good.lines().filter(|line| !line.contains("client.")).map(|line| format!("{line}\n")).collect();
    let rows = bcap_fleet::check(&Config::parse(&without).unwrap()).await.unwrap();
    assert!(rows[0].result.is_err(), "{rows:?}");

    // OpenSSL's variable names the authorities of the system
    let system =
        good.lines().filter(|line| !line.starts_with("ca =")).map(|line| format!("{line}\n")).collect::<String>();
    let file = broker.path().join("system.toml");
    fs::write(&file, system).unwrap();
    for (roots, code) in [("ca.pem", 0), ("broker.pem", 3)] {
        let check = Command::new(env!("CARGO_BIN_EXE_bcap-fleet"))
            .arg(&file)
            .arg("--check")
            .env("SSL_CERT_FILE", broker.path().join(roots))
            .output();
        let check = check.unwrap();
        assert_eq!(check.status.code(), Some(code), "{roots}: {check:?}");
    }

    fs::write(broker.path().join("password"), "another").unwrap();
    let rows = bcap_fleet::check(&Config::parse(&good).unwrap()).await.unwrap();
    let error = rows[0].result.as_ref().unwrap_err();
    assert!(!error.contains("another"), "no secret in an error: {error}");

    fs::write(broker.path().join("password"), "secret of the test").unwrap();
    let fleet = Running::start(&good).await;
    while !fleet.events.lock().unwrap().contains(&bcap_fleet::Event::BrokerUp {}) {
        tokio::time::sleep(std::time::Duration::from_millis(5)).await;
    }
    fleet.stop().await;
}
