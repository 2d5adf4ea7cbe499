//! A time limit for single calls.

use std::io;
use std::time::Duration;

use bcap_core::bcap::client::Timing;
use bcap_core::io::asynch::Transport;

use super::Session;

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Limits the time of each call from now on; `None` restores the usual limits.
    pub(crate) fn set_limit(&mut self, limit: Option<Duration>) {
        let client = self.connection.client();
        let usual = self.usual_timing.take().unwrap_or(client.timing());
        match limit {
            Some(limit) => {
                let Timing { attempt_timeout, deadline, keep_alive, .. } = usual;
                client.set_timing(Timing {
                    attempt_timeout: attempt_timeout.min(limit),
                    deadline: deadline.min(limit),
                    keep_alive: keep_alive.min(limit),
                    ..usual
                });
                self.usual_timing = Some(usual);
            }
            None => client.set_timing(usual),
        }
    }
}
