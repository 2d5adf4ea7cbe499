//! A RAC server under RTIC, on smoltcp without embassy: the board as a controller ([`node`](bcap_firmware::node)).
//!
//! ```text
//!  init ─► Ethernet, clock, sockets ─► idle: polls, and sleeps until a frame arrives or the clock ticks
//! ```
//!
//! A task with a deadline would preempt `idle`, on which no task waits.
#![no_std]
#![no_main]
#![allow(unsafe_code, reason = "RTIC generates `main`")]

use bcap_firmware::fault;

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fault::panic_text(info)
}

#[rtic::app(device = bcap_firmware::pac, peripherals = false)]
mod app {
    use bcap_core::rac::PORT;
    use bcap_core::rac::server::{Config, Session};
    use bcap_embassy::bare::{self, TcpServer};
    use bcap_embassy::clock::now;
    use bcap_firmware::lan9118::{Frames, Lan9118};
    use bcap_firmware::node::Node;
    use bcap_firmware::{clock, config, fault, uart};
    use smoltcp::iface::{self, Interface, PollResult, SocketHandle, SocketSet, SocketStorage};
    use smoltcp::socket::tcp;
    use smoltcp::wire::{EthernetAddress, IpCidr};
    use static_cell::{ConstStaticCell, StaticCell};

    /// Two sockets, so that one listens while the connection of the other closes; a client is refused until then.
    const SOCKETS: usize = 2;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        device: Lan9118<'static>,
        interface: Interface,
        sockets: SocketSet<'static>,
        servers: [(SocketHandle, TcpServer<Session<[u8; 64]>>); SOCKETS],
        node: Node,
    }

    #[init]
    fn init(context: init::Context) -> (Shared, Local) {
        static FRAMES: ConstStaticCell<Frames> = ConstStaticCell::new(Frames::new());
        static MEMORY: ConstStaticCell<[[[u8; 512]; 2]; SOCKETS]> = ConstStaticCell::new([[[0; 512]; 2]; SOCKETS]);
        static STORAGE: StaticCell<[SocketStorage<'static>; SOCKETS]> = StaticCell::new();

        uart::init();
        fault::init();
        clock::init(context.core.SYST);
        let settings = config::load(|_| {});
        let Ok(mut device) = Lan9118::new(settings.mac, FRAMES.take()) else { fault::end() };
        let address = EthernetAddress(device.address());
        let mut interface = Interface::new(iface::Config::new(address.into()), &mut device, bare::to_smoltcp(now()));
        if let Some((own, prefix)) = settings.address {
            // a new interface has room for an address
            interface.update_ip_addrs(|addresses| {
                let _ = addresses.push(IpCidr::new(own.into(), prefix));
            });
        }
        let mut sockets = SocketSet::new(&mut STORAGE.init([SocketStorage::EMPTY; SOCKETS])[..]);
        let mut index = 0;
        let servers = MEMORY.take().each_mut().map(|[rx, tx]| {
            let socket = tcp::Socket::new(tcp::SocketBuffer::new(&mut rx[..]), tcp::SocketBuffer::new(&mut tx[..]));
            let server = TcpServer::new(PORT, index, SOCKETS as u32);
            index += 1;
            (sockets.add(socket), server)
        });
        (Shared {}, Local { device, interface, sockets, servers, node: Node::new() })
    }

    #[idle(local = [device, interface, sockets, servers, node])]
    fn idle(context: idle::Context) -> ! {
        let idle::LocalResources { device, interface, sockets, servers, node, .. } = context.local;
        loop {
            let now = now();
            interface.poll(bare::to_smoltcp(now), device, sockets);
            for (socket, server) in &mut *servers {
                server.poll(sockets.get_mut(*socket), || Session::new(Config::TCP, [0; 64]), node, now);
            }
            if interface.poll(bare::to_smoltcp(now), device, sockets) == PollResult::None {
                cortex_m::asm::wfi();
            }
        }
    }
}
