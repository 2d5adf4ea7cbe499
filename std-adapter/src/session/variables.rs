//! Reading several variables, and waiting for a value.

use std::io;
use std::time::{Duration, Instant};

use bcap_core::bcap::Object;
use bcap_core::bcap::client::ClientError;
use bcap_core::io::asynch::Transport;
use bcap_core::variant::{FromVariant, OwnedVariant};

use super::Session;
use crate::CallError;
use crate::error::Error;

/// A value or error of a variable, with the time when the reply arrived or the reading failed.
pub type TimedReading = (Instant, Result<OwnedVariant, Error>);

/// The pause between two readings of a variable that [`Session::read_until`] waits for.
pub(crate) const POLL: Duration = Duration::from_millis(10);

impl<X: Transport<Error = io::Error>> Session<X> {
    /// Reads variables of any type; fails at the first variable that cannot be read.
    pub(crate) async fn read_all<const N: usize, S: AsRef<str>>(
        &mut self,
        names: &[S; N],
    ) -> Result<[OwnedVariant; N], Error> {
        let mut values = std::array::from_fn(|_| OwnedVariant::default());
        for (value, name) in values.iter_mut().zip(names) {
            *value = self.read(Object::Controller, name.as_ref()).await?;
        }
        Ok(values)
    }

    /// Reads variables of any type, and returns for each when its reply arrived, and its value or error. After a timeout or a
    /// loss of the connection the rest is not read.
    pub(crate) async fn read_each<S: AsRef<str>>(&mut self, names: &[S]) -> Vec<TimedReading> {
        let mut values = Vec::with_capacity(names.len());
        for name in names {
            let value = match self.lost() {
                None => self.read(Object::Controller, name.as_ref()).await,
                Some(error) => Err(error),
            };
            let is_last = value.as_ref().is_err_and(|error| is_timeout(error) || self.lost().is_some());
            values.push((Instant::now(), value));
            if is_last {
                break;
            }
        }
        values
    }

    /// Reads a variable until its value meets a condition, at most for `limit`.
    pub(crate) async fn read_until<T: for<'a> FromVariant<'a>>(
        &mut self,
        name: &str,
        condition: &mut dyn FnMut(&T) -> bool,
        limit: Duration,
    ) -> Result<T, Error> {
        let end = self.connection.transport().now().saturating_add(limit);
        loop {
            let value = self.read::<OwnedVariant>(Object::Controller, name).await?;
            let now = self.connection.transport().now();
            if let Some(met) = meets(name, &value, condition)? {
                return Ok(met);
            }
            if now >= end {
                return Err(Error::NotMet { object: name.to_owned(), limit, last: value });
            }
            self.connection.transport().sleep_until(end.min(now.saturating_add(POLL))).await;
        }
    }
}

/// Converts a value, and returns it if it meets the condition.
pub(crate) fn meets<T: for<'a> FromVariant<'a>>(
    name: &str,
    value: &OwnedVariant,
    condition: &mut dyn FnMut(&T) -> bool,
) -> Result<Option<T>, Error> {
    let value = value.convert().map_err(|source| Error::Value { object: name.to_owned(), source })?;
    Ok(Some(value).filter(|value| condition(value)))
}

/// Returns whether a call has no reply because its time limit has passed.
const fn is_timeout(error: &Error) -> bool {
    matches!(error, Error::NoReply { source: CallError::Client(ClientError::Timeout(_)), .. })
}
