//! The parts of a live screen.

/// What a live screen shows.
#[derive(Clone, Debug, Default)]
pub(crate) struct Screen {
    /// The first line: what this is, and the state of the controller.
    pub(crate) title: String,
    pub(crate) state: String,
    /// Whether the state needs attention: an error, or a lost connection.
    pub(crate) alarm: bool,
    /// The top left: variables or connections.
    pub(crate) values: Panel,
    pub(crate) robot: Panel,
    pub(crate) tasks: Panel,
    pub(crate) errors: Panel,
    pub(crate) messages: Panel,
    /// Packets or calls, the latest at the end.
    pub(crate) log: Panel,
    /// The answer to the last key, or a question.
    pub(crate) notice: Line,
    /// The keys.
    pub(crate) keys: String,
}

/// A part of the screen.
#[derive(Clone, Debug, Default)]
pub(crate) struct Panel {
    pub(crate) title: String,
    pub(crate) lines: Vec<Line>,
    /// Which lines are shown if not all fit.
    pub(crate) view: Part,
}

/// The part of the lines that is shown if not all fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Part {
    /// The first lines.
    #[default]
    First,
    /// The last lines.
    Last,
    /// The lines around this one, which is marked.
    Around(usize),
    /// The first lines; a long line continues on the next.
    Wrapped,
}

/// A line of a panel.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Line {
    pub(crate) text: String,
    /// The last values, which are drawn as a sparkline.
    pub(crate) history: Vec<f64>,
    pub(crate) mark: Mark,
}

/// How a line is marked. Each mark is visible without colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Mark {
    #[default]
    Plain,
    /// Has changed: bold, with `*`.
    Changed,
    /// Needs attention: bold and reversed.
    Alarm,
}

impl Panel {
    pub(crate) fn new(title: impl Into<String>, lines: Vec<Line>) -> Self {
        Self { title: title.into(), lines, view: Part::First }
    }

    pub(crate) fn showing(self, view: Part) -> Self {
        Self { view, ..self }
    }
}

impl Line {
    pub(crate) fn new(text: impl Into<String>) -> Self {
        Self { text: text.into(), ..Self::default() }
    }

    pub(crate) fn alarm(text: impl Into<String>) -> Self {
        Self { text: text.into(), mark: Mark::Alarm, ..Self::default() }
    }
}
