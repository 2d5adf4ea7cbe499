//! The parts of a live screen.

/// The contents of a live screen: a title, six panels and two lines.
#[derive(Clone, Debug, Default)]
pub struct Screen {
    /// The left of the first line: the program and its peer.
    pub title: String,
    /// The right of the first line: the state of the peer.
    pub state: String,
    /// Whether the state needs attention: an error, or a lost connection.
    pub alarm: bool,
    /// The top left: variables or connections.
    pub values: Panel,
    /// The top right: numbers, three a line.
    pub robot: Panel,
    /// Below it.
    pub tasks: Panel,
    /// The middle left.
    pub errors: Panel,
    /// The middle right.
    pub messages: Panel,
    /// Packets or calls, in chronological order.
    pub log: Panel,
    /// The answer to the last key, or a question.
    pub notice: Line,
    /// The keys.
    pub keys: String,
    /// Drawn in place of the panels: details of a line, or all keys.
    pub overlay: Option<Panel>,
}

/// A part of the screen.
#[derive(Clone, Debug, Default)]
pub struct Panel {
    /// The title in its border.
    pub title: String,
    /// All lines.
    pub lines: Vec<Line>,
    /// The selection of lines if not all fit.
    pub view: Part,
}

/// The part of the lines that is shown if not all fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Part {
    /// The first lines.
    #[default]
    First,
    /// The last lines.
    Last,
    /// The lines around this one, which is marked.
    Around(usize),
    /// The first lines; a long line continues on the next row.
    Wrapped,
}

/// A line of a panel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Line {
    /// The name of a value, which is shortened in its middle before the text is cut.
    pub name: String,
    /// The text, which is escaped when it is drawn.
    pub text: String,
    /// The last values, which are drawn as a sparkline.
    pub history: Vec<f64>,
    /// How it is marked.
    pub mark: Mark,
}

/// The mark of a line. Each mark is visible without colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mark {
    /// Not marked.
    #[default]
    Plain,
    /// Has changed: bold, with `*`.
    Changed,
    /// Needs attention: bold and reversed.
    Alarm,
}

impl Panel {
    /// A panel that shows its first lines.
    #[must_use]
    pub fn new(title: impl Into<String>, lines: Vec<Line>) -> Self {
        Self { title: title.into(), lines, view: Part::First }
    }

    /// Shows another part of the lines.
    #[must_use]
    pub fn showing(self, view: Part) -> Self {
        Self { view, ..self }
    }
}

impl Line {
    /// A line without a mark.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    /// A value after its name.
    #[must_use]
    pub fn named(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { name: name.into(), ..Self::new(text) }
    }

    /// A line that needs attention.
    #[must_use]
    pub fn alarm(text: impl Into<String>) -> Self {
        Self { text: text.into(), mark: Mark::Alarm, ..Self::default() }
    }
}
