//! Draws a [`Screen`].

use ratatui_core::buffer::Buffer;
use ratatui_core::layout::{Constraint, Layout, Rect};
use ratatui_core::style::{Color, Modifier, Style};
use ratatui_core::symbols::border;
use ratatui_core::terminal::Frame;
use ratatui_core::text::{Line as Styled, Text};
use ratatui_core::widgets::Widget as _;
use ratatui_widgets::block::Block;
use ratatui_widgets::paragraph::{Paragraph, Wrap};

use super::parts::{Line, Mark, Panel, Part, Screen};
use super::spark::sparkline;
use crate::escape;

/// The smallest terminal.
const SMALLEST: (u16, u16) = (70, 18);

/// The width of the robot's panel: three numbers a line.
const ROBOT: u16 = 40;

/// The largest width of a sparkline.
const SPARK: u16 = 60;

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
}

/// Draws the whole screen, or that the terminal is too small for it.
pub(super) fn draw(screen: &Screen, look: Look, frame: &mut Frame<'_>) {
    let area = frame.area();
    let (width, height) = SMALLEST;
    if area.width < width || area.height < height {
        let text = format!(
            "The terminal is {}x{}. This screen needs at least {width}x{height}: make the terminal larger. {}",
            area.width, area.height, screen.keys
        );
        frame.render_widget(Paragraph::new(text).wrap(Wrap { trim: true }), area);
        return;
    }
    let long = Styled::from(escape::line(&screen.notice.text)).width() > usize::from(area.width);
    let [title, top, middle, log, notice, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(11),
        Constraint::Fill(5),
        Constraint::Fill(5),
        Constraint::Length(if long { 2 } else { 1 }),
        Constraint::Length(1),
    ])
    .areas(area);
    let [values, right] = Layout::horizontal([Constraint::Fill(1), Constraint::Length(ROBOT)]).areas(top);
    let robot = u16::try_from(screen.robot.lines.len()).unwrap_or(u16::MAX).clamp(5, 6) + 2;
    let [robot, tasks] = Layout::vertical([Constraint::Length(robot), Constraint::Fill(1)]).areas(right);
    let [errors, messages] = Layout::horizontal([Constraint::Fill(1), Constraint::Fill(1)]).areas(middle);
    let buffer = frame.buffer_mut();
    head(screen, look, title, buffer);
    for (part, area) in [
        (&screen.values, values),
        (&screen.robot, robot),
        (&screen.tasks, tasks),
        (&screen.errors, errors),
        (&screen.messages, messages),
        (&screen.log, log),
    ] {
        panel(part, look, area, buffer);
    }
    let text = Styled::styled(escape::line(&screen.notice.text), look.style(screen.notice.mark));
    Paragraph::new(text).wrap(Wrap { trim: true }).render(notice, buffer);
    put(&screen.keys, Style::new().add_modifier(Modifier::DIM), keys, buffer);
}

/// Draws the first line: the title at the left, the state at the right.
fn head(screen: &Screen, look: Look, area: Rect, buffer: &mut Buffer) {
    let state = Styled::from(escape::line(&screen.state));
    let width = u16::try_from(state.width()).unwrap_or(u16::MAX).min(area.width * 3 / 4);
    let [left, right] = Layout::horizontal([Constraint::Fill(1), Constraint::Length(width)]).areas(area);
    put(
        &screen.title,
        Style::new().add_modifier(Modifier::BOLD),
        Rect { width: left.width.saturating_sub(1), ..left },
        buffer,
    );
    let mark = if screen.alarm { Mark::Alarm } else { Mark::Plain };
    put(&screen.state, look.style(mark), right, buffer);
}

fn panel(panel: &Panel, look: Look, area: Rect, buffer: &mut Buffer) {
    let set = if look.unicode { border::PLAIN } else { ASCII };
    let block = Block::bordered().border_set(set).title(format!(" {} ", escape::line(&panel.title)));
    let inner = block.inner(area);
    block.render(area, buffer);
    if panel.view == Part::Wrapped {
        let lines = panel.lines.iter().map(|line| Styled::styled(escape::line(&line.text), look.style(line.mark)));
        Paragraph::new(Text::from_iter(lines)).wrap(Wrap { trim: false }).render(inner, buffer);
        return;
    }
    let rows = usize::from(inner.height);
    let first = first_line(panel, rows);
    let hidden = panel.lines.len().saturating_sub(first + rows);
    let spark = if panel.lines.iter().any(|line| line.history.len() > 1) { (inner.width / 3).min(SPARK) } else { 0 };
    for (n, line) in panel.lines.iter().enumerate().skip(first).take(rows) {
        let y = inner.y + u16::try_from(n - first).unwrap_or(0);
        let row = Rect { y, height: 1, ..inner };
        if hidden > 0 && n + 1 == first + rows && panel.view == Part::First {
            put(&format!("({} more)", hidden + 1), Style::new(), row, buffer);
            continue;
        }
        let selected = match panel.view {
            Part::Around(selected) => Some(n == selected),
            _ => None,
        };
        draw_line(line, selected, spark, look, row, buffer);
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

/// Draws a line: marks, if lines can be selected, then the text, then the sparkline.
fn draw_line(line: &Line, selected: Option<bool>, spark: u16, look: Look, area: Rect, buffer: &mut Buffer) {
    let text = match selected {
        None => line.text.clone(),
        Some(selected) => {
            let cursor = if selected { '>' } else { ' ' };
            let changed = if line.mark == Mark::Changed { '*' } else { ' ' };
            format!("{cursor}{changed}{}", line.text)
        }
    };
    let gap = u16::from(spark > 0);
    let [left, _, right] =
        Layout::horizontal([Constraint::Fill(1), Constraint::Length(gap), Constraint::Length(spark)]).areas(area);
    put(&text, look.style(line.mark), left, buffer);
    if line.history.len() > 1 {
        put(&sparkline(&line.history, spark.into(), look.unicode), Style::new(), right, buffer);
    }
}

/// Writes escaped text, as much as fits.
fn put(text: &str, style: Style, area: Rect, buffer: &mut Buffer) {
    if area.height > 0 {
        buffer.set_stringn(area.x, area.y, escape::line(text), area.width.into(), style);
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
        let row = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>().trim_end().to_owned();
        (0..height).map(row).collect()
    }

    fn drawn(screen: &Screen, look: Look, (width, height): (u16, u16)) -> Buffer {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(screen, look, frame)).unwrap();
        terminal.backend().buffer().clone()
    }

    fn example() -> Screen {
        let lines = |texts: &[&str]| texts.iter().map(|text| Line::new(*text)).collect::<Vec<_>>();
        let mut values = lines(&["I1    = 5", "S1    = a\u{1b}[2J\u{202e}b"]);
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
            "│> S1    = a\\u{1b}[2J\\u{20             ││                                      │",
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
    fn a_small_terminal_says_so() {
        let rows = rows(&example(), PLAIN, (40, 10)).join(" ");
        assert!(rows.starts_with("The terminal is 40x10. This screen needs"), "{rows}");
        assert!(rows.contains("at least 70x18") && rows.contains("q quit"), "{rows}");
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
    }
}
