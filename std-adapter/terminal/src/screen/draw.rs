//! Draws a [`Screen`].

use ratatui_core::buffer::{Buffer, CellWidth as _};
use ratatui_core::layout::{Constraint, Layout, Rect};
use ratatui_core::style::{Color, Modifier, Style};
use ratatui_core::symbols::border;
use ratatui_core::terminal::Frame;
use ratatui_core::text::Span;
use ratatui_core::widgets::Widget as _;
use ratatui_widgets::block::Block;

use super::parts::{Line, Mark, Panel, Part, Screen};
use super::spark::sparkline;
use crate::escape;

/// The smallest terminal that shows all panels.
const ALL: (u16, u16) = (70, 18);

/// The width of the robot's panel: three numbers a line.
const ROBOT: u16 = 40;

/// The maximum width of a sparkline, and the minimum width that is drawn.
const SPARK: (u16, u16) = (60, 4);

/// The minimum width of a long name next to a long value.
const NAME: u16 = 6;

/// The maximum number of rows of the answer to a key.
const NOTICE: u16 = 3;

/// The separator between a name and its value.
const EQUALS: &str = " = ";

const ASCII: border::Set<'_> = border::Set {
    top_left: "+",
    top_right: "+",
    bottom_left: "+",
    bottom_right: "+",
    vertical_left: "|",
    vertical_right: "|",
    horizontal_top: "-",
    horizontal_bottom: "-",
};

/// The capabilities of the terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Look {
    pub(crate) colour: bool,
    /// Whether the terminal shows more than ASCII.
    pub(crate) unicode: bool,
}

impl Look {
    fn style(self, mark: Mark) -> Style {
        let (style, colour) = match mark {
            Mark::Plain => return Style::new(),
            Mark::Changed => (Style::new().add_modifier(Modifier::BOLD), Color::Yellow),
            Mark::Alarm => (Style::new().add_modifier(Modifier::BOLD | Modifier::REVERSED), Color::Red),
        };
        if self.colour { style.fg(colour) } else { style }
    }

    /// The mark of text that is cut.
    const fn cut(self) -> &'static str {
        if self.unicode { "…" } else { "..." }
    }
}

/// Draws the whole screen. A small terminal shows its main parts only.
pub(super) fn draw(screen: &Screen, look: Look, frame: &mut Frame<'_>) {
    let area = frame.area();
    let (width, height) = ALL;
    let is_small = area.width < width || area.height < height;
    let rows = wrap(&escape::line(&screen.notice.text), area.width).take(NOTICE.into()).count();
    let notice = u16::try_from(rows).unwrap_or(NOTICE);
    let keys = u16::from(!is_small || rows == 0);
    let [title, main, notice, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(if is_small { notice } else { notice.max(1) }),
        Constraint::Length(keys),
    ])
    .areas(area);
    let buffer = frame.buffer_mut();
    head(screen, look, is_small, title, buffer);
    match &screen.overlay {
        Some(overlay) if is_small => lines(overlay, look, main, buffer),
        Some(overlay) => panel(overlay, look, main, buffer),
        None if is_small => lines(&screen.values, look, main, buffer),
        None => panels(screen, look, main, buffer),
    }
    wrapped(std::slice::from_ref(&screen.notice), look, notice, buffer);
    let small = format!("{width}x{height} shows all panels  {}", screen.keys);
    let text = if is_small { &small } else { &screen.keys };
    put(text, Style::new().add_modifier(Modifier::DIM), look, keys, buffer);
}

/// Draws the six panels.
fn panels(screen: &Screen, look: Look, area: Rect, buffer: &mut Buffer) {
    let [top, middle, log] =
        Layout::vertical([Constraint::Fill(11), Constraint::Fill(5), Constraint::Fill(5)]).areas(area);
    let right = if screen.robot.title.is_empty() { 0 } else { ROBOT };
    let [values, right] = Layout::horizontal([Constraint::Fill(1), Constraint::Length(right)]).areas(top);
    let robot = u16::try_from(screen.robot.lines.len()).unwrap_or(u16::MAX).clamp(5, 6) + 2;
    let [robot, tasks] = Layout::vertical([Constraint::Length(robot), Constraint::Fill(1)]).areas(right);
    let [errors, messages] = Layout::horizontal([Constraint::Fill(1), Constraint::Fill(1)]).areas(middle);
    for (part, area) in [
        (&screen.values, values),
        (&screen.robot, robot),
        (&screen.tasks, tasks),
        (&screen.errors, errors),
        (&screen.messages, messages),
        (&screen.log, log),
    ] {
        // borders need two
        if area.height > 2 && area.width > 2 {
            panel(part, look, area, buffer);
        }
    }
}

/// Draws the first line: the title at the left, the state at the right. A small terminal shows the state alone.
fn head(screen: &Screen, look: Look, is_small: bool, area: Rect, buffer: &mut Buffer) {
    let most = if is_small { area.width } else { area.width * 3 / 4 };
    let width = columns(&escape::line(&screen.state)).min(most);
    let left = if is_small { 0 } else { area.width - width };
    let title = Rect { width: left.saturating_sub(1), ..area };
    put(&screen.title, Style::new().add_modifier(Modifier::BOLD), look, title, buffer);
    let mark = if screen.alarm { Mark::Alarm } else { Mark::Plain };
    put(&screen.state, look.style(mark), look, Rect { x: area.x + left, width, ..area }, buffer);
}

fn panel(panel: &Panel, look: Look, area: Rect, buffer: &mut Buffer) {
    let set = if look.unicode { border::PLAIN } else { ASCII };
    let block = Block::bordered().border_set(set);
    let inner = block.inner(area);
    block.render(area, buffer);
    let title = Rect { x: inner.x, width: inner.width, height: 1, ..area };
    put(&format!(" {} ", panel.title), Style::new(), look, title, buffer);
    lines(panel, look, inner, buffer);
}

fn lines(panel: &Panel, look: Look, area: Rect, buffer: &mut Buffer) {
    if panel.view == Part::Wrapped {
        return wrapped(&panel.lines, look, area, buffer);
    }
    let rows = usize::from(area.height);
    let first = first_line(panel, rows);
    let hidden = panel.lines.len().saturating_sub(first + rows);
    let names = panel.lines.iter().map(|line| columns(&escape::line(&line.name))).max().unwrap_or(0);
    for (n, line) in panel.lines.iter().enumerate().skip(first).take(rows) {
        let y = area.y + u16::try_from(n - first).unwrap_or(0);
        let row = Rect { y, height: 1, ..area };
        if hidden > 0 && n + 1 == first + rows && panel.view == Part::First {
            put(&format!("({} more)", hidden + 1), Style::new(), look, row, buffer);
            continue;
        }
        let style = look.style(line.mark);
        let row = match panel.view {
            Part::Around(selected) => {
                let cursor = if selected == n { '>' } else { ' ' };
                let changed = if line.mark == Mark::Changed { '*' } else { ' ' };
                put(&format!("{cursor}{changed}"), style, look, Rect { width: row.width.min(2), ..row }, buffer);
                rest(row, 2)
            }
            _ => row,
        };
        draw_line(line, names, look, row, buffer);
    }
}

/// Returns the first line that is shown.
fn first_line(panel: &Panel, rows: usize) -> usize {
    let last = panel.lines.len().saturating_sub(rows);
    match panel.view {
        Part::First | Part::Wrapped => 0,
        Part::Last => last,
        Part::Around(line) => line.saturating_sub(rows / 2).min(last),
    }
}

/// Draws a line: its name in a column of `names`, its text, and in the rest its sparkline. The text has priority for the
/// columns, then the name.
fn draw_line(line: &Line, names: u16, look: Look, area: Rect, buffer: &mut Buffer) {
    let style = look.style(line.mark);
    let text = columns(&escape::line(&line.text));
    let mut right = area;
    if !line.name.is_empty() {
        let name = escape::line(&line.name);
        let equals = columns(EQUALS);
        let least = columns(&name).min(NAME);
        let column = area.width.saturating_sub(text.saturating_add(equals)).max(least).min(names);
        put(&shortened(&name, column, look), style, look, Rect { width: column.min(area.width), ..area }, buffer);
        right = rest(area, column);
        put(EQUALS, style, look, right, buffer);
        right = rest(right, equals);
    }
    put(&line.text, style, look, right, buffer);
    let (most, least) = SPARK;
    let room = rest(right, text.saturating_add(1)).width.min(most).min(area.width / 3);
    if line.history.len() > 1 && room >= least {
        let bars = sparkline(&line.history, room.into(), look.unicode);
        put(&bars, Style::new(), look, rest(area, area.width - room), buffer);
    }
}

/// Shortens a name in its middle: its ends are the most informative.
fn shortened(name: &str, width: u16, look: Look) -> String {
    if columns(name) <= width {
        return name.to_owned();
    }
    let letters: Vec<char> = name.chars().collect();
    let kept = usize::from(width.saturating_sub(columns(look.cut()))).min(letters.len());
    let (head, tail) = (letters.iter().take(kept.div_ceil(2)), letters.iter().skip(letters.len() - kept / 2));
    head.chain(look.cut().chars().collect::<Vec<_>>().iter()).chain(tail).collect()
}

/// Draws lines that continue on the next row. The last row is marked if it is not the end.
fn wrapped(lines: &[Line], look: Look, area: Rect, buffer: &mut Buffer) {
    let texts = lines.iter().flat_map(|line| {
        let text = escape::line(&line.text);
        let rows = wrap(&text, area.width).take(usize::from(area.height) + 1);
        rows.map(|row| (row.to_owned(), look.style(line.mark))).collect::<Vec<_>>()
    });
    let mut texts = texts.take(usize::from(area.height) + 1).peekable();
    for y in area.top()..area.bottom() {
        let Some((mut row, style)) = texts.next() else { return };
        if y + 1 == area.bottom() && texts.peek().is_some() {
            row.push_str(look.cut());
        }
        put(&row, style, look, Rect { y, height: 1, ..area }, buffer);
    }
}

/// Breaks a text into rows, at blanks where possible.
fn wrap(text: &str, width: u16) -> impl Iterator<Item = &str> {
    let mut left = if width > 0 { text } else { "" };
    std::iter::from_fn(move || {
        let (mut end, mut used, mut blank) = (0, 0_u16, None);
        for (bytes, columns) in symbols(left) {
            if end > 0 && left.get(end..).is_some_and(|next| next.starts_with(' ')) {
                blank = Some(end);
            }
            used = used.saturating_add(columns);
            if used > width && end > 0 {
                let (row, next) = left.split_at(blank.unwrap_or(end));
                left = next.trim_start_matches(' ');
                return Some(row);
            }
            end += bytes;
        }
        Some(std::mem::take(&mut left)).filter(|row| !row.is_empty())
    })
}

/// Returns the part of a row after some columns.
fn rest(area: Rect, columns: u16) -> Rect {
    let used = columns.min(area.width);
    Rect { x: area.x + used, width: area.width - used, ..area }
}

/// Returns the bytes and the columns of each symbol, such as a letter with its accents.
fn symbols(text: &str) -> Vec<(usize, u16)> {
    let span = Span::raw(text);
    span.styled_graphemes(Style::new()).map(|grapheme| (grapheme.symbol.len(), grapheme.symbol.cell_width())).collect()
}

/// Returns the columns that a text takes when it is drawn.
fn columns(text: &str) -> u16 {
    symbols(text).iter().fold(0, |sum, (_, columns)| sum.saturating_add(*columns))
}

/// Writes escaped text. Text that does not fit ends with a mark.
fn put(text: &str, style: Style, look: Look, area: Rect, buffer: &mut Buffer) {
    if area.is_empty() {
        return;
    }
    let text = escape::line(text);
    let fits = columns(&text) <= area.width;
    let cut = columns(look.cut()).min(area.width);
    let room = if fits { area.width } else { area.width - cut };
    let (x, y) = buffer.set_stringn(area.x, area.y, text, room.into(), style);
    if !fits {
        buffer.set_stringn(x, y, look.cut(), cut.into(), style);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ratatui_core::backend::TestBackend;
    use ratatui_core::terminal::Terminal;

    const PLAIN: Look = Look { colour: false, unicode: true };

    fn rows(screen: &Screen, look: Look, (width, height): (u16, u16)) -> Vec<String> {
        let buffer = drawn(screen, look, (width, height));
        let row = |y| {
            // a wide symbol leaves the next cell empty
            let mut next = 0;
            let shown = (0..width).filter(|x| {
                let is_shown = *x >= next;
                next = next.max(x + buffer[(*x, y)].symbol().cell_width());
                is_shown
            });
            let row: String = shown.map(|x| buffer[(x, y)].symbol()).collect();
            row.trim_end().to_owned()
        };
        (0..height).map(row).collect()
    }

    fn drawn(screen: &Screen, look: Look, (width, height): (u16, u16)) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(screen, look, frame)).unwrap();
        terminal.backend().buffer().clone()
    }

    fn example() -> Screen {
        let lines = |texts: &[&str]| texts.iter().map(|text| Line::new(*text)).collect::<Vec<_>>();
        let mut values = vec![Line::named("I1", "5"), Line::named("IO128", "a\u{1b}[2J\u{202e}b")];
        (values[0].mark, values[0].history) = (Mark::Changed, vec![0.0, 1.0, 2.0, 7.0]);
        Screen {
            title: "bcap monitor tcp:robot".into(),
            state: "RC8 auto ok".into(),
            values: Panel::new("variables", values).showing(Part::Around(1)),
            robot: Panel::new("robot", lines(&["J1 1"])),
            tasks: Panel::new("tasks", lines(&["Pro1 ready", "Pro2 ready", "Pro3 ready", "Pro4 ready"])),
            errors: Panel::new(
                "errors",
                lines(&["0x84204041: the error text is so long that it continues on the next line"]),
            )
            .showing(Part::Wrapped),
            messages: Panel::new("messages", vec![]),
            log: Panel::new("packets", (0..9).map(|n| Line::new(format!("packet {n}"))).collect()).showing(Part::Last),
            notice: Line::alarm("halted"),
            keys: "q quit".into(),
            ..Screen::default()
        }
    }

    #[test]
    fn the_screen_fills_80_by_24() {
        let expected = [
            "bcap monitor tcp:robot                                               RC8 auto ok",
            "┌ variables ───────────────────────────┐┌ robot ───────────────────────────────┐",
            "│ *I1    = 5               ▁▂▃█        ││J1 1                                  │",
            "│> IO128 = a\\u{1b}[2J\\u{202e}b         ││                                      │",
            "│                                      ││                                      │",
            "│                                      ││                                      │",
            "│                                      ││                                      │",
            "│                                      │└──────────────────────────────────────┘",
            "│                                      │┌ tasks ───────────────────────────────┐",
            "│                                      ││Pro1 ready                            │",
            "│                                      ││(3 more)                              │",
            "└──────────────────────────────────────┘└──────────────────────────────────────┘",
            "┌ errors ──────────────────────────────┐┌ messages ────────────────────────────┐",
            "│0x84204041: the error text is so long ││                                      │",
            "│that it continues on the next line    ││                                      │",
            "│                                      ││                                      │",
            "└──────────────────────────────────────┘└──────────────────────────────────────┘",
            "┌ packets ─────────────────────────────────────────────────────────────────────┐",
            "│packet 6                                                                      │",
            "│packet 7                                                                      │",
            "│packet 8                                                                      │",
            "└──────────────────────────────────────────────────────────────────────────────┘",
            "halted",
            "q quit",
        ];
        assert_eq!(rows(&example(), PLAIN, (80, 24)), expected);
    }

    #[test]
    fn a_long_notice_has_two_lines() {
        let mut screen = example();
        screen.notice = Line::new(format!("NOT HALTED: {}; use the emergency stop", "x".repeat(60)));
        let rows = rows(&screen, PLAIN, (80, 24));
        assert!(rows[21].starts_with("NOT HALTED: ") && rows[22].ends_with("the emergency stop"), "{rows:#?}");
        assert_eq!(rows[23], "q quit");
    }

    #[test]
    fn a_larger_terminal_shows_more() {
        let rows = rows(&example(), PLAIN, (200, 50));
        assert_eq!(rows.len(), 50);
        let has = |text: &str| rows.iter().any(|row| row.contains(text));
        assert!(has("Pro4 ready") && has("packet 0") && has("a\\u{1b}[2J\\u{202e}b"), "{}", rows.join("\n"));
        assert!(rows[0].ends_with("RC8 auto ok") && rows[0].chars().count() == 200);
    }

    #[test]
    fn changes_and_alarms_are_visible_without_colours() {
        let buffer = drawn(&example(), PLAIN, (80, 24));
        assert!(buffer[(3, 2)].modifier.contains(Modifier::BOLD));
        assert!(buffer[(0, 22)].modifier.contains(Modifier::REVERSED));
        assert!(buffer.content.iter().all(|cell| cell.fg == Color::Reset && cell.bg == Color::Reset));
        let coloured = drawn(&example(), Look { colour: true, ..PLAIN }, (80, 24));
        assert_eq!([coloured[(3, 2)].fg, coloured[(0, 22)].fg], [Color::Yellow, Color::Red]);
    }

    #[test]
    fn a_terminal_without_unicode_gets_ascii() {
        let rows = rows(&example(), Look { unicode: false, ..PLAIN }, (80, 24));
        assert!(rows.iter().all(|row| row.is_ascii()), "{}", rows.join("\n"));
        assert!(rows[2].starts_with("| *I1    = 5               _.-#"), "{}", rows[2]);
    }

    #[test]
    fn a_small_terminal_shows_the_state_the_values_and_the_answer() {
        let mut screen = example();
        let small = |screen: &Screen| rows(screen, PLAIN, (20, 5));
        let values = [" *I1    = 5   ▁▂▃█", "> IO128 = a\\u{1b}[2…"];
        assert_eq!(small(&screen), ["RC8 auto ok", values[0], values[1], "", "halted"]);
        screen.notice = Line::default();
        assert_eq!(small(&screen)[4], "70x18 shows all pan…");
        // a question is never truncated without a mark
        screen.notice = Line::alarm("write IO128 = 123456789, now 987654321, y/N");
        assert_eq!(small(&screen)[2..], ["write IO128 =", "123456789, now", "987654321, y/N"]);
        screen.notice = Line::default();
        screen.overlay = Some(Panel::new("keys", vec![Line::new("q quits"), Line::new("h halts")]));
        assert_eq!(small(&screen)[..3], ["RC8 auto ok", "q quits", "h halts"]);
    }

    #[test]
    fn text_that_continues_is_marked_where_it_ends() {
        let mut screen = example();
        screen.errors.lines = vec![Line::new("one two ".repeat(20)), Line::new("the next")];
        screen.robot.lines = vec![Line::new("123456.789 ".repeat(4))];
        let rows = rows(&screen, PLAIN, (80, 24));
        assert!(rows[15].starts_with("│one two one two one two one two one…  ││"), "{}", rows.join("\n"));
        assert!(rows[2].ends_with("│123456.789 123456.789 123456.789 1234…│"), "{}", rows.join("\n"));
    }

    /// Asserts that the rows of the values show their whole text, or a beginning and the mark.
    fn assert_honest(screen: &Screen, look: Look, (width, height): (u16, u16)) {
        let all = width >= ALL.0 && height >= ALL.1;
        let room = if all { width - ROBOT - 2 } else { width };
        let shown: Vec<String> =
            rows(screen, look, (width, height)).into_iter().filter(|row| row.contains('Q')).collect();
        assert!(!shown.is_empty(), "no value at {width}x{height}");
        for (row, line) in shown.iter().zip(&screen.values.lines) {
            let row = &row[row.find('Q').unwrap()..];
            let row = row.split(['│', '|']).next().unwrap();
            let (name, value) = row.split_once(" = ").unwrap_or_else(|| panic!("no value in {row:?}"));
            let bars = |c: char| c == ' ' || ('▁'..='█').contains(&c);
            let (name, value, whole) = (name.trim_end(), value.trim_end_matches(bars), escape::line(&line.text));
            let whole = whole.trim_end();
            match value.strip_suffix(look.cut()) {
                Some(start) => assert!(whole.starts_with(start), "{value:?} of {whole:?}"),
                None => assert_eq!(value, whole, "{row:?} at {width}x{height}"),
            }
            if columns(whole) + columns(&line.name).min(NAME) + 5 <= room {
                assert_eq!(value, whole, "{row:?} at {width}x{height} has room");
            }
            match name.split_once(look.cut()) {
                Some((head, tail)) => assert!(line.name.starts_with(head) && line.name.ends_with(tail), "{name}"),
                None => assert_eq!(name, line.name),
            }
        }
    }

    proptest::proptest! {
        #[test]
        fn every_size_is_drawn(width in 1_u16..220, height in 1_u16..60, selected in 0_usize..9, text in ".{0,90}") {
            let mut screen = example();
            screen.values.view = Part::Around(selected);
            screen.state.clone_from(&text);
            screen.robot.lines.push(Line::new(text));
            drawn(&screen, PLAIN, (width, height));
        }

        #[test]
        fn a_value_is_shown_whole_or_marked(
            size in (20_u16..=250, 5_u16..=80),
            unicode: bool,
            values in proptest::collection::vec(("Q[A-PR-Za-z0-9:/@]{0,40}", "[0-9a-z,;é世界\u{1b}]{1,60}( [a-z]{1,60})?"), 1..9),
            history in proptest::collection::vec(-9.0_f64..9.0, 0..70),
        ) {
            let mut screen = example();
            let history = if unicode { history } else { Vec::new() };
            let line = |(name, text)| Line { history: history.clone(), ..Line::named(name, text) };
            screen.values = Panel::new("variables", values.into_iter().map(line).collect()).showing(Part::Around(0));
            assert_honest(&screen, Look { unicode, colour: false }, size);
        }
    }
}
