//! The end of a transfer over USB: a host waits for more bytes after a full packet.

use embedded_io_async::{ErrorType, Write};

/// Ends each transfer with a packet that is not full: `flush` sends an empty one after a full one.
#[derive(Debug)]
pub(crate) struct Packets<W, const SIZE: usize> {
    pub(crate) sender: W,
    is_full: bool,
}

impl<W, const SIZE: usize> Packets<W, SIZE> {
    /// `sender` sends each write of up to `SIZE` bytes as one packet.
    pub(crate) const fn new(sender: W) -> Self {
        Self { sender, is_full: false }
    }
}

impl<W: ErrorType, const SIZE: usize> ErrorType for Packets<W, SIZE> {
    type Error = W::Error;
}

impl<W: Write, const SIZE: usize> Write for Packets<W, SIZE> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        let count = self.sender.write(bytes).await?;
        self.is_full = count == SIZE;
        Ok(count)
    }

    async fn flush(&mut self) -> Result<(), Self::Error> {
        if self.is_full {
            self.write(&[]).await?;
        }
        self.sender.flush().await
    }
}

#[cfg(test)]
mod tests {
    use core::convert::Infallible;
    use std::vec::Vec;

    use embassy_futures::block_on;

    use super::*;

    /// The sizes of the packets.
    struct Sender(Vec<usize>);

    impl ErrorType for Sender {
        type Error = Infallible;
    }

    impl Write for Sender {
        async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
            let count = bytes.len().min(64);
            self.0.push(count);
            Ok(count)
        }

        async fn flush(&mut self) -> Result<(), Infallible> {
            Ok(())
        }
    }

    #[test]
    fn an_empty_packet_follows_a_full_one() {
        let mut packets = Packets::<_, 64>::new(Sender(Vec::new()));
        for (len, expected) in [(63, &[63][..]), (64, &[64, 0]), (65, &[64, 1]), (128, &[64, 64, 0])] {
            let Ok(()) = block_on(packets.write_all(&std::vec![0; len]));
            for _ in 0..2 {
                let Ok(()) = block_on(packets.flush());
            }
            assert_eq!(core::mem::take(&mut packets.sender.0), expected, "{len} bytes");
        }
    }
}
