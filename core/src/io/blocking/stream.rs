//! The calls of a Slave Mode stream, over a connection that blocks.

use super::{Connection, Transport};
use crate::bcap::client::Config;
use crate::bcap::slave::{Engine, MoveReply};
use crate::io::{CallError, failure};
use crate::storage::Storage;

impl<X: Transport, T: Storage, R: Storage> Connection<X, T, R> {
    /// Makes the call that an engine wants, and hands its reply or failure in; `moved` sees the answer to a slvMove that
    /// was carried out. On links that lose frames a slvMove is repeated after
    /// [`attempt_timeout`](Engine::attempt_timeout).
    ///
    /// Returns why the call had no reply. The engine knows that already: it is for the log, and the stream goes on with
    /// the engine's next [`Action`](crate::bcap::slave::Action).
    pub fn carry_out<const N: usize>(
        &mut self,
        engine: &mut Engine<N>,
        moved: impl FnOnce(&MoveReply<'_>),
    ) -> Option<CallError<X::Error>> {
        let request = engine.request()?;
        let usual = *self.client.config();
        if let Some(attempt_timeout) = engine.attempt_timeout().filter(|_| usual.link.is_lossy()) {
            self.client.set_config(Config { attempt_timeout, ..usual });
        }
        let error = self.call(&request).err().filter(|error| error.hresult().is_none());
        self.client.set_config(usual);
        let now = self.transport.now();
        match (error, self.client.reply()) {
            (None, Some(reply)) => {
                if let Some(reply) = engine.handle_reply(&reply, now) {
                    moved(&reply);
                }
                None
            }
            (error, _) => {
                engine.handle_failure(failure(error.as_ref()), now);
                error
            }
        }
    }
}
