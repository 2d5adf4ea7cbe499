//! Text of a controller for a page.

use bcap_terminal::escape;

/// Cuts a text of the controller, and escapes characters that act on the text around them.
pub(crate) fn safe(text: &str) -> String {
    escape::line(&escape::cut(&text))
}
