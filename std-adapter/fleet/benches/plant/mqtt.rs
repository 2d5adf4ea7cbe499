//! A small MQTT 3.1.1 client for measurements: it costs less than a library, and so shows the capacity of the broker.

use std::io::{BufReader, Read, Write};
use std::net::TcpStream;

use crate::Failure;

/// A message with its topic.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    /// 0 or 1.
    pub(crate) qos: u8,
    pub(crate) retain: bool,
}

/// Connects, and waits until the broker has accepted it.
pub(crate) fn connect(port: u16, id: &str) -> Result<(TcpStream, Packets), Failure> {
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    stream.set_nodelay(true)?;
    // version 4, clean session, no keep-alive
    let mut body = b"\0\x04MQTT\x04\x02\0\0".to_vec();
    text(&mut body, id)?;
    stream.write_all(&packet(0x10, &body)?)?;
    let mut packets = Packets { reader: BufReader::with_capacity(1 << 18, stream.try_clone()?) };
    match packets.next()? {
        (0x20, accepted) if accepted.get(1) == Some(&0) => Ok((stream, packets)),
        other => Err(format!("the broker did not accept the connection: {other:?}").into()),
    }
}

/// Subscribes with QoS 0, and waits until the broker has confirmed it.
pub(crate) fn subscribe(stream: &mut TcpStream, packets: &mut Packets, topic: &str) -> Result<(), Failure> {
    let mut body = vec![0, 1];
    text(&mut body, topic)?;
    body.push(0);
    stream.write_all(&packet(0x82, &body)?)?;
    while packets.next()?.0 != 0x90 {}
    Ok(())
}

/// Returns the bytes of a message; `id` is needed with QoS 1.
pub(crate) fn publish(message: &Message, id: u16) -> Result<Vec<u8>, Failure> {
    let mut body = Vec::new();
    text(&mut body, &message.topic)?;
    if message.qos > 0 {
        body.extend(id.to_be_bytes());
    }
    body.extend(&message.payload);
    packet(0x30 | message.qos << 1 | u8::from(message.retain), &body)
}

/// The packets that arrive on a connection.
pub(crate) struct Packets {
    reader: BufReader<TcpStream>,
}

impl Packets {
    /// Waits for a packet; returns its first byte and its body.
    pub(crate) fn next(&mut self) -> Result<(u8, Vec<u8>), Failure> {
        let kind = self.byte()?;
        let (mut length, mut shift) = (0, 0);
        loop {
            let byte = self.byte()?;
            length |= usize::from(byte & 0x7F) << shift;
            shift += 7;
            if byte & 0x80 == 0 {
                break;
            }
        }
        let mut body = vec![0; length];
        self.reader.read_exact(&mut body)?;
        Ok((kind, body))
    }

    /// Waits for a message.
    pub(crate) fn message(&mut self) -> Result<Message, Failure> {
        loop {
            let (kind, body) = self.next()?;
            if kind & 0xF0 == 0x30 {
                return split(kind, &body).ok_or_else(|| "a message of the broker is cut".into());
            }
        }
    }

    fn byte(&mut self) -> Result<u8, Failure> {
        let mut byte = [0];
        self.reader.read_exact(&mut byte)?;
        let [byte] = byte;
        Ok(byte)
    }
}

fn split(kind: u8, body: &[u8]) -> Option<Message> {
    let (length, rest) = body.split_first_chunk()?;
    let (topic, payload) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length)))?;
    let topic = String::from_utf8_lossy(topic).into_owned();
    Some(Message { topic, payload: payload.to_vec(), qos: 0, retain: kind & 1 != 0 })
}

fn packet(kind: u8, body: &[u8]) -> Result<Vec<u8>, Failure> {
    let mut bytes = vec![kind];
    let mut rest = body.len();
    loop {
        let low = u8::try_from(rest % 128)?;
        rest /= 128;
        bytes.push(if rest > 0 { low | 0x80 } else { low });
        if rest == 0 {
            break;
        }
    }
    bytes.extend(body);
    Ok(bytes)
}

fn text(body: &mut Vec<u8>, text: &str) -> Result<(), Failure> {
    body.extend(u16::try_from(text.len())?.to_be_bytes());
    body.extend(text.as_bytes());
    Ok(())
}
