//! A page of the book as a list of actions.

use std::fs;
use std::path::Path;

/// A command of a page.
#[derive(Debug, Default)]
pub(crate) struct Command {
    /// The page and the line, for messages.
    pub(crate) place: String,
    pub(crate) text: String,
    /// The output that the page shows; empty if it shows none.
    pub(crate) output: Vec<String>,
    pub(crate) exit: i32,
}

/// The action of the test at a place of a page.
#[derive(Debug)]
pub(crate) enum Action {
    /// Starts another virtual controller with these options.
    Sim(String),
    /// Runs a command that the reader does not see.
    Hidden(Command),
    /// Writes a file.
    File { name: String, content: String },
    /// Runs the commands of a block, if this program is installed.
    Commands { needs: Option<String>, commands: Vec<Command> },
    /// Does not run a block.
    Skipped { commands: usize, reason: String },
}

/// A page of the book.
#[derive(Debug)]
pub(crate) struct Page {
    pub(crate) name: String,
    pub(crate) actions: Vec<Action>,
    /// The Rust programs that doc tests compile.
    pub(crate) programs: usize,
}

/// A fenced block, with the comments above it that concern it.
#[derive(Default)]
struct Block {
    language: String,
    lines: Vec<(usize, String)>,
    file: Option<String>,
    needs: Option<String>,
    skip: Option<String>,
}

impl Page {
    /// Reads a page of the folder.
    pub(crate) fn read(folder: &Path, name: &str) -> Self {
        let text = fs::read_to_string(folder.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut page = Self { name: name.to_owned(), actions: Vec::new(), programs: 0 };
        let mut block = Block::default();
        let mut is_open = false;
        for (index, line) in text.lines().enumerate() {
            let number = index + 1;
            if let Some(language) = line.strip_prefix("```") {
                if is_open {
                    page.finish(std::mem::take(&mut block));
                } else {
                    assert!(!language.is_empty(), "{name}:{number}: this block has no language");
                    language.clone_into(&mut block.language);
                }
                is_open = !is_open;
            } else if is_open {
                block.lines.push((number, line.to_owned()));
            } else if let Some(directive) = line.strip_prefix("<!-- book: ") {
                let directive = directive.strip_suffix(" -->").unwrap_or_else(|| panic!("{name}:{number}: no end"));
                page.direct(directive, number, &mut block);
            }
        }
        assert!(!is_open, "{name}: a block does not end");
        page
    }

    fn direct(&mut self, directive: &str, number: usize, block: &mut Block) {
        let (verb, rest) = directive.split_once(' ').unwrap_or((directive, ""));
        let rest = rest.to_owned();
        match verb {
            "sim" => self.actions.push(Action::Sim(rest)),
            "run" => self.actions.push(Action::Hidden(self.command(number, &rest))),
            "file" => block.file = Some(rest),
            "needs" => block.needs = Some(rest),
            "skip" => block.skip = Some(rest),
            _ => panic!("{}:{number}: unknown directive {verb}", self.name),
        }
    }

    fn finish(&mut self, block: Block) {
        if block.language.starts_with("rust") && !block.language.contains("ignore") {
            self.programs += 1;
        }
        if let Some(name) = block.file {
            let content = block.lines.iter().flat_map(|(_, line)| [line, "\n"]).collect();
            self.actions.push(Action::File { name, content });
        } else if block.language == "console" {
            let commands = self.commands(&block.lines);
            self.actions.push(match block.skip {
                Some(reason) => Action::Skipped { commands: commands.len(), reason },
                None => Action::Commands { needs: block.needs, commands },
            });
        } else {
            assert!(!["sh", "bash", "shell"].contains(&block.language.as_str()), "{}: use `console`", self.name);
        }
    }

    fn commands(&self, lines: &[(usize, String)]) -> Vec<Command> {
        let mut commands: Vec<Command> = Vec::new();
        for (number, line) in lines {
            let last = commands.last_mut();
            match (line.strip_prefix("$ "), last) {
                (Some(text), _) => commands.push(self.command(*number, text)),
                (None, Some(last)) if last.text.ends_with('\\') && last.output.is_empty() => {
                    last.text.pop();
                    last.text.push_str(line.trim_start());
                }
                (None, Some(last)) => last.output.push(line.trim_end().to_owned()),
                (None, None) => panic!("{}:{number}: output without a command", self.name),
            }
        }
        commands
    }

    fn command(&self, number: usize, text: &str) -> Command {
        let (text, exit) = match text.split_once("# exit code ") {
            Some((text, code)) => (text.trim_end(), code.parse().unwrap()),
            None => (text, 0),
        };
        Command { place: format!("{}:{number}", self.name), text: text.to_owned(), output: Vec::new(), exit }
    }
}
