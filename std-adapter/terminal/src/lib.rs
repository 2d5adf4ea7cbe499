//! Output, signals and live screens of the programs `bcap` and `bcap-fleet`.
//!
//! | module     | contents                                                                   |
//! |------------|----------------------------------------------------------------------------|
//! | `args`     | parses the command line; feature `args`                                    |
//! | `escape`   | escapes untrusted text before it is printed                                |
//! | `progress` | the progress of a command, a line on the standard error                    |
//! | `report`   | an error and its hint on the standard error                                |
//! | `signal`   | the signals that end or suspend a program                                  |
//! | `screen`   | a live screen of panels; feature `screens`                                 |
//! | `words`    | the words of a line, with quotes and variables                             |

#[cfg(feature = "args")]
pub mod args;
pub mod escape;
pub mod progress;
pub mod report;
#[cfg(feature = "screens")]
pub mod screen;
pub mod signal;
pub mod words;
