//! A b-CAP client on smoltcp without embassy that reads a variable of the robot and prints it on the serial port.
//!
//! ```text
//!  I1 = I4(42)          at the start, and after each line received
//!  cannot read I1: ...
//!  q                    ends the program
//! ```
#![no_std]
#![no_main]

use core::fmt::{self, Write as _};

use bcap_board::{Settings, stack};
use bcap_core::bcap::call::{self, Call, ControllerHandle, Reply, VariableHandle};
use bcap_core::bcap::client::{Client, ClientError, Config as ClientConfig, Event};
use bcap_core::hresult::HResult;
use bcap_core::time::Instant;
use bcap_embassy::bare::{self, LinkError};
use bcap_firmware::lan9118::{Frames, Lan9118};
use bcap_firmware::uart::{self, Text};
use bcap_firmware::{clock, config, fault};
use smoltcp::iface::{self, Interface, SocketHandle, SocketSet};
use smoltcp::socket::tcp;
use smoltcp::wire::{EthernetAddress, IpCidr};
use static_cell::ConstStaticCell;

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    fault::panic_text(info)
}

#[cortex_m_rt::entry]
fn main() -> ! {
    stack::run(program)
}

extern "C" fn program() -> ! {
    static FRAMES: ConstStaticCell<Frames> = ConstStaticCell::new(Frames::new());
    static MEMORY: ConstStaticCell<[[u8; 1024]; 2]> = ConstStaticCell::new([[0; 1024]; 2]);

    uart::init();
    fault::init();
    if let Some(peripherals) = cortex_m::Peripherals::take() {
        clock::init(peripherals.SYST);
    }
    let settings = config::load(|line| {
        let _ = writeln!(Text, "settings: cannot read \"{}\"", line.escape_ascii());
    });
    let mut device = match Lan9118::new(settings.mac, FRAMES.take()) {
        Ok(device) => device,
        Err(error) => {
            let _ = writeln!(Text, "no Ethernet controller: {error:?}");
            fault::end()
        }
    };
    let [rx, tx] = MEMORY.take();
    let mut storage = [iface::SocketStorage::EMPTY];
    let mut sockets = SocketSet::new(&mut storage[..]);
    let socket = tcp::Socket::new(tcp::SocketBuffer::new(&mut rx[..]), tcp::SocketBuffer::new(&mut tx[..]));
    let socket = sockets.add(socket);
    let mut robot = Robot {
        interface: interface(&mut device, settings),
        device,
        sockets,
        socket,
        client: Client::new(ClientConfig::TCP, [0; 512], [0; 512]),
        variable: None,
        next_port: 49_152,
    };
    loop {
        match robot.read(settings) {
            Ok(()) => {}
            Err(error) => {
                let _ = writeln!(Text, "cannot read {}: {error}", settings.variable);
                robot.variable = None;
            }
        }
        robot.wait_for_line();
    }
}

/// Creates the interface with the configured address.
fn interface(device: &mut Lan9118<'_>, settings: &Settings<'_>) -> Interface {
    let address = EthernetAddress(device.address());
    let mut interface = Interface::new(iface::Config::new(address.into()), device, bare::to_smoltcp(now()));
    // without DHCP it needs a configured address
    let Some((own, prefix)) = settings.address else { return interface };
    // a new interface has room for an address and a route
    interface.update_ip_addrs(|addresses| {
        let _ = addresses.push(IpCidr::new(own.into(), prefix));
    });
    if let Some(gateway) = settings.gateway {
        let _ = interface.routes_mut().add_default_ipv4_route(gateway);
    }
    interface
}

fn now() -> Instant {
    bcap_embassy::clock::now()
}

/// The connection to the robot.
struct Robot<'m> {
    device: Lan9118<'m>,
    interface: Interface,
    sockets: SocketSet<'m>,
    socket: SocketHandle,
    client: Client<[u8; 512]>,
    /// The variable's handle while connected.
    variable: Option<VariableHandle>,
    next_port: u16,
}

/// Why the variable could not be read.
enum Error {
    Connect,
    Link(LinkError),
    Client(ClientError),
    Refused(HResult),
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connect => f.write_str("cannot connect"),
            Self::Link(error) => error.fmt(f),
            Self::Client(error) => error.fmt(f),
            Self::Refused(code) => write!(f, "the controller refused: {code}"),
        }
    }
}

impl From<ClientError> for Error {
    fn from(error: ClientError) -> Self {
        Self::Client(error)
    }
}

impl Robot<'_> {
    /// Reads the variable and writes its value to the serial port.
    fn read(&mut self, settings: &Settings<'_>) -> Result<(), Error> {
        let variable = match self.variable {
            Some(variable) => variable,
            None => self.open(settings)?,
        };
        self.call(&call::variable_get_value(variable))?;
        if let Some(value) = self.client.reply().and_then(|reply| reply.value()) {
            let _ = writeln!(Text, "{} = {value:?}", settings.variable);
        }
        Ok(())
    }

    /// Connects and opens the variable.
    fn open(&mut self, settings: &Settings<'_>) -> Result<VariableHandle, Error> {
        self.connect(settings)?;
        self.call(&call::service_start(""))?;
        let controller: ControllerHandle =
            self.value(&call::controller_connect("", settings.provider, "localhost", ""))?;
        let variable = self.value(&call::controller_get_variable(controller, settings.variable, ""))?;
        self.variable = Some(variable);
        Ok(variable)
    }

    fn connect(&mut self, settings: &Settings<'_>) -> Result<(), Error> {
        self.client.reset();
        self.next_port = self.next_port.checked_add(1).unwrap_or(49_152);
        let socket = self.sockets.get_mut::<tcp::Socket<'_>>(self.socket);
        socket.abort();
        bare::set_up(socket);
        let peer = settings.robot.address;
        socket.connect(self.interface.context(), peer, self.next_port).map_err(|_| Error::Connect)
    }

    /// Makes a call and reads the value of its reply.
    fn value<C: Call, V>(&mut self, call: &C) -> Result<V, Error>
    where
        C::Reply: for<'a> Reply<Value<'a> = V>,
    {
        self.call(call)?;
        Ok(self.client.value::<C::Reply>()?)
    }

    /// Makes a call and waits for its end.
    fn call<C: Call>(&mut self, call: &C) -> Result<(), Error> {
        self.client.start(call, self.client.timing(), now())?;
        loop {
            let now = now();
            self.interface.poll(bare::to_smoltcp(now), &mut self.device, &mut self.sockets);
            let socket = self.sockets.get_mut(self.socket);
            match bare::poll_tcp(&mut self.client, socket, now).map_err(Error::Link)? {
                Some(Event::Replied(code)) if code.is_err() => return Err(Error::Refused(code)),
                Some(Event::Replied(_)) => return Ok(()),
                Some(Event::Failed(error)) => return Err(Error::Client(error)),
                Some(_) => {}
                // bytes that the client just queued are sent before the sleep
                None if self.interface.poll(bare::to_smoltcp(now), &mut self.device, &mut self.sockets)
                    == iface::PollResult::None =>
                {
                    // until a frame arrives or the clock ticks
                    cortex_m::asm::wfi();
                }
                None => {}
            }
        }
    }

    /// Keeps the connection alive until a line is received; ends the program at a `q`.
    fn wait_for_line(&mut self) {
        loop {
            match uart::read() {
                Some(b'q') => fault::succeed(),
                Some(b'\n' | b'\r') => return,
                Some(_) => {}
                None => {
                    self.interface.poll(bare::to_smoltcp(now()), &mut self.device, &mut self.sockets);
                    cortex_m::asm::wfi();
                }
            }
        }
    }
}
