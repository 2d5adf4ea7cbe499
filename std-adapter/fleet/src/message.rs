//! A message to the broker.

use rumqttc::QoS;

use crate::reading::Reading;

/// A message to the broker.
#[derive(Clone, Debug)]
pub(crate) struct Message {
    pub(crate) topic: String,
    pub(crate) payload: Vec<u8>,
    pub(crate) qos: QoS,
    pub(crate) retain: bool,
    /// The number of readings in its list, with those that are not sent again.
    pub(crate) entries: usize,
    /// The readings that are sent again if the broker does not acknowledge the message.
    pub(crate) readings: Vec<Reading>,
}
