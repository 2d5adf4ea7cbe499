//! Typed calls: one Rust function for each of the 137 functions of b-CAP.
//!
//! A call is a value that contains its function and arguments, and its type determines the type of the reply. It does nothing
//! until a client sends it. All are generated from the [function table](super::function), so names and types agree with the
//! wire.
//!
//! The documentation of a call says what the function does, its arguments with their units, what it returns, and which
//! controllers have it; "all" are RC8, RC9 and COBOTTA. The specifications are the b-CAP specification for RC9 and the
//! RAC specification for RC8. The virtual controller is the crate `bcap-sim`.
//!
//! The usual calls of an object are also methods of its handle: `controller.variable("I1")`, `variable.get()`,
//! `robot.take_arm(0, 1)`, see [`ControllerHandle`].
//!
//! # Examples
//!
//! ```
//! use bcap_core::bcap::call::{self, Call, VariableHandle};
//! use bcap_core::bcap::FunctionId;
//!
//! let get = call::variable_get_value(VariableHandle(3));
//! assert_eq!(get.function(), FunctionId::VARIABLE_GET_VALUE);
//! ```

mod objects;

use core::fmt;

use crate::bcap::function::for_each_function;
use crate::bcap::{Args, FrameWriter, FunctionId};
use crate::error::EncodeError;
use crate::variant::{Bstr, Encode, VarType, Variant, Writer};

/// A call: a function with its arguments.
pub trait Call {
    /// The value of its reply.
    type Reply: Reply;

    /// Returns the function.
    fn function(&self) -> FunctionId;

    /// Appends the arguments to a frame.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Full`] when they do not fit.
    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError>;

    /// Returns the prepared frame of the call, without CRC, if it has one. A client copies that frame, sets serial and
    /// reserved field, and does not encode the arguments. On serial lines it still encodes them.
    #[inline]
    fn prepared(&self) -> Option<&[u8]> {
        None
    }
}

impl<C: Call + ?Sized> Call for &C {
    type Reply = C::Reply;

    fn function(&self) -> FunctionId {
        (**self).function()
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        (**self).arguments(frame)
    }

    #[inline]
    fn prepared(&self) -> Option<&[u8]> {
        (**self).prepared()
    }
}

/// The type of the value in a reply, read from the arguments of the reply's frame.
pub trait Reply {
    /// The value, which may borrow from the frame.
    type Value<'a>;

    /// Reads the value.
    ///
    /// # Errors
    ///
    /// A [`ReplyError`] when the reply carries a value of another type.
    fn read(args: Args<'_>) -> Result<Self::Value<'_>, ReplyError>;
}

/// A reply carries a value of another type than its function returns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub struct ReplyError {
    /// The expected value, in words.
    pub expected: &'static str,
    /// The type of the value; `None` without a value.
    pub found: Option<VarType>,
}

impl fmt::Display for ReplyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.found {
            Some(found) => write!(f, "the reply carries {found} instead of {}", self.expected),
            None => write!(f, "the reply carries no value; expected {}", self.expected),
        }
    }
}

impl core::error::Error for ReplyError {}

/// Reads the first value of a reply with `read`.
fn value<'a, T>(
    args: Args<'a>,
    expected: &'static str,
    read: impl FnOnce(&Variant<'a>) -> Option<T>,
) -> Result<T, ReplyError> {
    let found = args.first();
    found.as_ref().and_then(read).ok_or(ReplyError { expected, found: found.map(|v| v.vartype()) })
}

fn handle_from(args: Args<'_>, expected: &'static str) -> Result<i32, ReplyError> {
    value(args, expected, |v| match *v {
        // some servers send handles as unsigned numbers
        Variant::Ui4(n) => Some(n.cast_signed()),
        _ => v.as_i32(),
    })
}

/// Returns the handle in a reply, of an object of any kind.
pub(crate) fn handle_of(args: Args<'_>) -> Result<i32, ReplyError> {
    handle_from(args, "a handle")
}

/// A reply without a value; a value is ignored.
#[derive(Clone, Copy, Debug)]
pub struct Nothing;

impl Reply for Nothing {
    type Value<'a> = ();

    fn read(_args: Args<'_>) -> Result<(), ReplyError> {
        Ok(())
    }
}

/// A reply with an integer.
#[derive(Clone, Copy, Debug)]
pub struct Int;

impl Reply for Int {
    type Value<'a> = i32;

    fn read(args: Args<'_>) -> Result<i32, ReplyError> {
        value(args, "an integer of 32 bits", Variant::as_i32)
    }
}

/// A reply with a string.
#[derive(Clone, Copy, Debug)]
pub struct Text;

impl Reply for Text {
    type Value<'a> = Bstr<'a>;

    fn read(args: Args<'_>) -> Result<Bstr<'_>, ReplyError> {
        value(args, "a string", |v| if v.is_empty() { Some(Bstr::default()) } else { v.as_bstr() })
    }
}

/// A reply with any value; EMPTY if it has none.
#[derive(Clone, Copy, Debug)]
pub struct Any;

impl Reply for Any {
    type Value<'a> = Variant<'a>;

    fn read(args: Args<'_>) -> Result<Variant<'_>, ReplyError> {
        Ok(args.first().unwrap_or(Variant::Empty))
    }
}

/// A reply that carries a value from some controllers, and none from others.
#[derive(Clone, Copy, Debug)]
pub struct Maybe;

impl Reply for Maybe {
    type Value<'a> = Option<Variant<'a>>;

    fn read(args: Args<'_>) -> Result<Option<Variant<'_>>, ReplyError> {
        Ok(args.first())
    }
}

macro_rules! handles {
    ($($name:ident $text:literal;)*) => {$(
        #[doc = concat!("The handle of a ", $text, ", assigned by the server and valid on the connection that opened it.")]
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name(pub i32);

        impl Encode for $name {
            #[inline]
            fn encode(&self, out: &mut Writer<'_>) -> Result<(), EncodeError> {
                self.0.encode(out)
            }
        }

        impl Reply for $name {
            type Value<'a> = Self;

            fn read(args: Args<'_>) -> Result<Self, ReplyError> {
                let handle = handle_from(args, concat!("the handle of a ", $text))?;
                Ok(Self(handle))
            }
        }
    )*};
}

handles! {
    ControllerHandle "controller";
    ExtensionHandle "extension";
    FileHandle "file";
    RobotHandle "robot";
    TaskHandle "task";
    VariableHandle "variable";
    CommandHandle "command";
    MessageHandle "message";
}

/// Maps the kind of an argument in the table to its type.
macro_rules! argument {
    (Int) => { i32 };
    (Float) => { f32 };
    (Text) => { &str };
    (Any) => { impl Encode };
    (Controller) => { ControllerHandle };
    (Extension) => { ExtensionHandle };
    (File) => { FileHandle };
    (Robot) => { RobotHandle };
    (Task) => { TaskHandle };
    (Variable) => { VariableHandle };
    (Command) => { CommandHandle };
    (Message) => { MessageHandle };
}

/// Maps the kind of a reply in the table to its type.
macro_rules! reply {
    (Controller) => {
        ControllerHandle
    };
    (Extension) => {
        ExtensionHandle
    };
    (File) => {
        FileHandle
    };
    (Robot) => {
        RobotHandle
    };
    (Task) => {
        TaskHandle
    };
    (Variable) => {
        VariableHandle
    };
    (Command) => {
        CommandHandle
    };
    (Message) => {
        MessageHandle
    };
    ($other:ident) => {
        $other
    };
}

macro_rules! calls {
    ($($(#[doc = $help:literal])*
       $number:literal $constant:ident $method:ident $name:literal $object:ident
       ($($argument:ident: $kind:ident),*) $result:ident, $effect:ident $in_slave_mode:ident;)*) => {$(
        $(#[doc = $help])*
        #[doc = ""]
        #[doc = concat!(" Function ", stringify!($number), ", `", $name, "`.")]
        #[must_use]
        #[inline]
        pub fn $method($($argument: argument!($kind)),*) -> impl Call<Reply = reply!($result)> {
            Typed::<_, reply!($result)> {
                function: FunctionId::$constant,
                arguments: ($($argument,)*),
                reply: core::marker::PhantomData,
            }
        }
    )*};
}

for_each_function!(calls);

/// A function with a tuple of arguments.
struct Typed<A, R> {
    function: FunctionId,
    arguments: A,
    reply: core::marker::PhantomData<R>,
}

/// A tuple of arguments.
trait Arguments {
    fn put(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError>;
}

macro_rules! arguments {
    ($(($($name:ident)*))*) => {$(
        impl<$($name: Encode),*> Arguments for ($($name,)*) {
            #[inline]
            fn put(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
                let _ = &frame;
                #[allow(non_snake_case, reason = "the arguments are named as their types")]
                let ($($name,)*) = self;
                $(frame.argument($name)?;)*
                Ok(())
            }
        }
    )*};
}

arguments!(() (A) (A B) (A B C) (A B C D) (A B C D E));

impl<A: Arguments, R: Reply> Call for Typed<A, R> {
    type Reply = R;

    #[inline]
    fn function(&self) -> FunctionId {
        self.function
    }

    #[inline]
    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.arguments.put(frame)
    }
}

/// A call whose function number and arguments are known at run time; any number is sent unchanged.
///
/// # Examples
///
/// ```
/// use bcap_core::bcap::call::RawCall;
/// use bcap_core::bcap::FunctionId;
///
/// let call = RawCall { function: FunctionId::ROBOT_HALT, arguments: &[&3_i32, &""] };
/// # let _ = call;
/// ```
#[derive(Clone, Copy)]
pub struct RawCall<'a> {
    /// The function.
    pub function: FunctionId,
    /// Its arguments.
    pub arguments: &'a [&'a dyn Encode],
}

impl Call for RawCall<'_> {
    type Reply = Maybe;

    fn function(&self) -> FunctionId {
        self.function
    }

    fn arguments(&self, frame: &mut FrameWriter<'_>) -> Result<(), EncodeError> {
        self.arguments.iter().try_for_each(|argument| frame.argument(*argument))
    }
}

impl fmt::Debug for RawCall<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}(.. {} arguments)", self.function, self.arguments.len())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::bcap::Decoder;
    use crate::hresult::HResult;

    /// Encodes a call, and passes the decoded function and arguments to `check`.
    fn sent(call: impl Call, check: impl FnOnce(FunctionId, Args<'_>)) {
        let mut buffer = [0; 256];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        call.arguments(&mut frame).unwrap();
        let bytes = frame.finish(1, 0, call.function().0).unwrap();
        let frame = Decoder::TCP.decode_datagram(bytes).unwrap();
        check(frame.function(), frame.args);
    }

    fn replied<R: Reply>(reply: &dyn Encode, check: impl FnOnce(Result<R::Value<'_>, ReplyError>)) {
        let mut buffer = [0; 256];
        let mut frame = FrameWriter::new(&mut buffer).unwrap();
        frame.argument(reply).unwrap();
        let bytes = frame.finish(1, 0, HResult::S_OK.0).unwrap();
        check(R::read(Decoder::TCP.decode_datagram(bytes).unwrap().args));
    }

    #[test]
    fn arguments_have_the_types_of_the_table() {
        sent(robot_accelerate(RobotHandle(3), -1, 50.0, 25.0), |function, args| {
            assert_eq!(function, FunctionId::ROBOT_ACCELERATE);
            let expected = [Variant::I4(3), Variant::I4(-1), Variant::R4(50.0), Variant::R4(25.0)];
            assert!(args.iter().eq(expected));
        });
        sent(robot_execute(RobotHandle(3), "TakeArm", [0, 1]), |_, args| {
            let kinds = FunctionId::ROBOT_EXECUTE.signature().unwrap().arguments;
            assert!(args.iter().zip(kinds).all(|(value, kind)| kind.accepts(&value)));
            assert_eq!(args.get(1).unwrap().as_bstr().unwrap(), "TakeArm");
            assert_eq!(args.get(2).unwrap().as_array().unwrap().items().unwrap().to_array(), Some([0, 1]));
        });
        sent(service_stop(), |function, args| {
            assert_eq!((function.0, args.len()), (2, 0));
        });
    }

    #[test]
    fn replies_are_read_or_refused() {
        replied::<VariableHandle>(&7_i32, |r| assert_eq!(r, Ok(VariableHandle(7))));
        replied::<VariableHandle>(&u32::MAX, |r| assert_eq!(r, Ok(VariableHandle(-1))));
        replied::<VariableHandle>(&"7", |r| assert_eq!(r.unwrap_err().found, Some(VarType::BSTR)));
        replied::<Text>(&(), |r| assert!(r.unwrap().is_empty()));
        replied::<Int>(&3_u8, |r| assert_eq!(r, Ok(3)));
        replied::<Nothing>(&3_u8, |r| assert_eq!(r, Ok(())));
        assert_eq!(Int::read(Args::NONE).unwrap_err().found, None);
        assert_eq!(Any::read(Args::NONE), Ok(Variant::Empty));
        assert_eq!(Maybe::read(Args::NONE), Ok(None));
    }
}
