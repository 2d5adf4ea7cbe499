//! The parts of the flash that updates use, as offsets. The boot loader also includes this file.

use bcap_board::update::Partitions;

/// The name of the hardware, because a project made from this image has another name.
pub(crate) const BOARD: &str = "w5500-evb-pico";

pub(crate) const PARTITIONS: Partitions = Partitions {
    active: 0x01_0000..0x10_0000,
    // a sector larger
    other: 0x10_0000..0x1f_1000,
    state: 0x1f_1000..0x1f_3000,
    history: 0x1f_3000..0x1f_5000,
    signature: 0x1f_5000..0x1f_6000,
};
