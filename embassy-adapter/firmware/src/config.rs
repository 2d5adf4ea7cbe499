//! The block of flash that a host tool patches: where the robot is, and the board's own address.
//!
//! ```text
//!  "BCAPCONF"  key=value LF  key=value LF  ...  NUL up to 512 bytes
//! ```
//!
//! The block stands in the image as it is, ELF or binary, so that whoever finds the eight letters can write behind them;
//! the script `configure` does. A line that cannot be read is skipped and logged; a key that is not there has the
//! default of [`Config::default`].

use core::net::{Ipv4Addr, SocketAddrV4};
use core::str;

use crate::mmio;

const LEN: usize = 512;
const MAGIC: &[u8; 8] = b"BCAPCONF";

#[used]
static BLOCK: [u8; LEN] = {
    let mut block = [0; LEN];
    let mut i = 0;
    while i < MAGIC.len() {
        block[i] = MAGIC[i];
        i += 1;
    }
    block
};

/// What the host tool can set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Config {
    /// `robot=10.0.2.2:5007`: the robot controller.
    pub robot: SocketAddrV4,
    /// `provider=CaoProv.DENSO.VRC9`: the provider to connect to there.
    pub provider: heapless::String<64>,
    /// `variable=I1`: what the image `bare` reads.
    pub variable: heapless::String<32>,
    /// `address=10.0.2.15/24`: the board's own address when no DHCP server answers.
    pub address: (Ipv4Addr, u8),
    /// `gateway=10.0.2.2`: the way to other networks, with that address.
    pub gateway: Ipv4Addr,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            robot: SocketAddrV4::new(Ipv4Addr::new(10, 0, 2, 2), 5007),
            provider: text("CaoProv.DENSO.VRC9").unwrap_or_default(),
            variable: text("I1").unwrap_or_default(),
            address: (Ipv4Addr::new(10, 0, 2, 15), 24),
            gateway: Ipv4Addr::new(10, 0, 2, 2),
        }
    }
}

impl Config {
    /// Reads the block.
    #[must_use]
    pub fn load() -> Self {
        let block = mmio::read_patched(&BLOCK);
        let mut config = Self::default();
        let text = block.get(MAGIC.len()..).unwrap_or_default();
        let text = text.split(|b| *b == 0).next().unwrap_or_default();
        for line in text.split(|b| *b == b'\n').filter(|line| !line.is_empty()) {
            if config.set(line).is_none() {
                defmt::warn!("configuration: cannot read \"{=[u8]:a}\"", line);
            }
        }
        config
    }

    fn set(&mut self, line: &[u8]) -> Option<()> {
        let (key, value) = str::from_utf8(line).ok()?.split_once('=')?;
        match key {
            "robot" => self.robot = value.parse().ok()?,
            "provider" => self.provider = text(value)?,
            "variable" => self.variable = text(value)?,
            "address" => {
                let (address, prefix) = value.split_once('/')?;
                self.address = (address.parse().ok()?, prefix.parse().ok().filter(|prefix| *prefix <= 32)?);
            }
            "gateway" => self.gateway = value.parse().ok()?,
            _ => return None,
        }
        Some(())
    }
}

fn text<const N: usize>(text: &str) -> Option<heapless::String<N>> {
    heapless::String::try_from(text).ok()
}
