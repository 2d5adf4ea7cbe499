//! Servers on free ports of this machine.

pub(crate) mod relay;

use std::net::SocketAddr;
use std::thread;

use bcap_conform::{Level, Link, Options, Report, Target, Verdict, run};
use bcap_core::{bcap, rac};
use bcap_sim::Profile;
use bcap_std::server::Server;
use tokio::sync::oneshot;

/// A server that ends when this is dropped.
pub(crate) struct Served {
    pub(crate) tcp: SocketAddr,
    pub(crate) udp: SocketAddr,
    pub(crate) rac: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Served {
    pub(crate) fn start<H>(handler: H) -> Self
    where
        H: bcap::server::Handler + rac::server::Handler + Send + 'static,
    {
        let (stop, stopped) = oneshot::channel();
        let (ready, addresses) = std::sync::mpsc::channel();
        let thread = thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(async {
                let any = "127.0.0.1:0";
                let server = Server::new(handler).bcap_tcp(any).await.unwrap().bcap_udp(any).await.unwrap();
                let server = server.rac_tcp(any).await.unwrap();
                ready.send(server.addresses()).unwrap();
                server.run(async { drop(stopped.await) }).await.unwrap();
            });
        });
        let addresses = addresses.recv().unwrap();
        Self {
            tcp: addresses.bcap_tcp[0],
            udp: addresses.bcap_udp[0],
            rac: addresses.rac_tcp[0],
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    pub(crate) fn options(&self, link: Link, level: Level) -> Options {
        let address = if link == Link::Tcp { self.tcp } else { self.udp };
        let target = Target { bcap: Some((link, address)), rac: Some(self.rac) };
        Options { level, ..Options::new(target) }
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        drop(self.stop.take());
        let _ = self.thread.take().unwrap().join();
    }
}

/// The provider of a model.
pub(crate) fn provider(profile: Profile) -> String {
    match profile {
        Profile::Rc9 | Profile::CobottaPro => "CaoProv.DENSO.VRC9".into(),
        _ => "CaoProv.DENSO.VRC".into(),
    }
}

/// Runs the cases, and prints the failures and the skips.
pub(crate) fn report(options: &Options) -> Report {
    let report = run(
        options,
        |result| {
            if result.verdict != Verdict::Pass {
                println!("{}", result.text())
            }
        },
        || false,
    );
    let mut slow: Vec<_> = report.results.iter().map(|result| (result.milliseconds, &result.name)).collect();
    slow.sort();
    println!("{}; slowest: {:?}", report.summary(), &slow[slow.len().saturating_sub(12)..]);
    report
}
