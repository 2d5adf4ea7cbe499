//! Replies of typed calls as values that outlive the connection's buffer.

use bcap_core::bcap::call::{
    Any, CommandHandle, ControllerHandle, ExtensionHandle, FileHandle, Int, Maybe, MessageHandle, Nothing, Reply,
    RobotHandle, TaskHandle, Text, VariableHandle,
};
use bcap_core::variant::OwnedVariant;

/// The type of a reply whose value can be copied out of the buffer of the connection.
///
/// | reply               | value                  |
/// |---------------------|------------------------|
/// | [`Nothing`]         | `()`                   |
/// | [`Int`]             | `i32`                  |
/// | [`Text`]            | `String`               |
/// | [`Any`]             | [`OwnedVariant`]       |
/// | [`Maybe`]           | `Option<OwnedVariant>` |
/// | the handle of an object, such as [`VariableHandle`] | itself |
pub trait OwnedReply: Reply + 'static {
    /// The copied value.
    type Owned: Send + 'static;

    /// Copies a value.
    fn owned(value: Self::Value<'_>) -> Self::Owned;
}

macro_rules! owned {
    ($($reply:ty => $owned:ty, $value:ident => $copy:expr;)*) => {$(
        impl OwnedReply for $reply {
            type Owned = $owned;

            fn owned($value: Self::Value<'_>) -> $owned {
                $copy
            }
        }
    )*};
}

owned! {
    Nothing => (), value => value;
    Int => i32, value => value;
    Text => String, value => value.to_string();
    Any => OwnedVariant, value => OwnedVariant::from(value);
    Maybe => Option<OwnedVariant>, value => value.map(OwnedVariant::from);
    ControllerHandle => Self, value => value;
    ExtensionHandle => Self, value => value;
    FileHandle => Self, value => value;
    RobotHandle => Self, value => value;
    TaskHandle => Self, value => value;
    VariableHandle => Self, value => value;
    CommandHandle => Self, value => value;
    MessageHandle => Self, value => value;
}
