//! The answer to the first request of a client without a slot.

use crate::bcap::FrameWriter;
use crate::hresult::HResult;

/// The length of a frame without arguments.
pub const REFUSAL: usize = 16;

/// Writes the reply E_MAX_CONNECT to the request with this serial.
pub fn refusal(serial: u16, buffer: &mut [u8; REFUSAL]) -> &[u8] {
    let reply = FrameWriter::new(buffer).and_then(|reply| reply.finish(serial, 0, HResult::E_MAX_CONNECT.0));
    reply.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bcap::Decoder;

    #[test]
    fn the_refusal_is_a_frame() {
        let mut buffer = [0; REFUSAL];
        let reply = refusal(7, &mut buffer);
        let frame = Decoder::UDP.decode_datagram(reply).expect("a frame");
        assert_eq!((reply.len(), frame.serial, frame.hresult()), (REFUSAL, 7, HResult::E_MAX_CONNECT));
    }
}
