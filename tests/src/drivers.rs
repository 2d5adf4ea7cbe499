//! The call sequences of public drivers and programs: `tests/drivers/*.jsonl`; its README explains the format.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use bcap_core::bcap::FunctionId;
use bcap_core::hresult::HResult;
use bcap_sim::Profile;
use serde::Deserialize;
use serde_json::Value as Json;

use bcap_testkit::value::{ARRAY, VARIANT, Value};

/// A link of b-CAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the variants are the links")]
pub enum Link {
    Tcp,
    Udp,
}

/// A model of controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the variants are the models")]
pub enum Model {
    Rc8,
    Rc8a,
    Rc9,
    Cobotta,
    #[serde(rename = "cobotta-pro")]
    CobottaPro,
}

impl Model {
    /// All models.
    pub const ALL: [Self; 5] = [Self::Rc8, Self::Rc8a, Self::Rc9, Self::Cobotta, Self::CobottaPro];

    /// Returns the profile of the virtual controller.
    #[must_use]
    pub const fn profile(self) -> Profile {
        match self {
            Self::Rc8 => Profile::Rc8,
            Self::Rc8a => Profile::Rc8a,
            Self::Rc9 => Profile::Rc9,
            Self::Cobotta => Profile::Cobotta,
            Self::CobottaPro => Profile::CobottaPro,
        }
    }

    /// Returns the model whose programs it also runs.
    #[must_use]
    pub const fn like(self) -> Self {
        match self {
            Self::Rc8 | Self::Rc8a => Self::Rc8,
            Self::Rc9 | Self::CobottaPro => Self::Rc9,
            Self::Cobotta => Self::Cobotta,
        }
    }
}

/// The first line of a file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// The name of the sequence.
    pub name: String,
    /// Where the facts are from.
    pub source: String,
    /// The models that it is for.
    pub models: Vec<Model>,
    /// Its sessions and the link of each in the real program; one over TCP unless given.
    #[serde(default = "one_session")]
    pub sessions: BTreeMap<String, Link>,
    /// The outcome on models that it is not for.
    #[serde(default)]
    pub elsewhere: BTreeMap<Model, Failure>,
    /// The controller at the start: a scenario of the virtual controller, in TOML.
    #[serde(default)]
    pub scenario: String,
    /// The user variables at the start.
    #[serde(default)]
    pub variables: BTreeMap<String, Json>,
}

impl Head {
    /// Returns what happens on a model that it is not for.
    #[must_use]
    pub fn failure(&self, model: Model) -> Option<&Failure> {
        self.elsewhere.get(&model).or_else(|| self.elsewhere.get(&model.like()))
    }
}

fn one_session() -> BTreeMap<String, Link> {
    BTreeMap::from([(MAIN.to_owned(), Link::Tcp)])
}

/// The session of a step without a session name.
pub const MAIN: &str = "main";

/// The first step that departs from the sequence.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Failure {
    /// Its function, or the command that it executes.
    pub at: String,
    /// Its code.
    pub code: Code,
}

/// An HRESULT: a name or a number in hexadecimal digits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct Code(pub HResult);

impl TryFrom<String> for Code {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let number = text.strip_prefix("0x").and_then(|digits| u32::from_str_radix(digits, 16).ok());
        let code = number.map(|n| HResult(n.cast_signed())).or_else(|| HResult::from_name(&text));
        code.map(Self).ok_or_else(|| format!("{text} is no HRESULT"))
    }
}

/// The code that a call is to be answered with.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub enum Expected {
    /// On every model.
    Always(Code),
    /// By model; S_OK on the others.
    ByModel(BTreeMap<Model, Code>),
}

impl Expected {
    /// Returns the code for a model.
    #[must_use]
    pub fn of(&self, model: Model) -> HResult {
        match self {
            Self::Always(code) => code.0,
            Self::ByModel(codes) => codes.get(&model).map_or(HResult::S_OK, |code| code.0),
        }
    }
}

/// A line after the first; one of its keys determines its kind.
#[derive(Clone, Debug)]
pub enum Step {
    /// A call.
    Call(Box<Call>),
    /// A stream of slvMove calls.
    Stream(Box<Stream>),
    /// Steps that are repeated.
    Repeat(Repeat),
    /// The client sends no calls for this time.
    Pause(Pause),
    /// Something happens to the controller.
    Event(Event),
}

impl<'de> Deserialize<'de> for Step {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let json = Json::deserialize(deserializer)?;
        let has = |key| json.get(key).is_some();
        let step = match () {
            () if has("call") => Box::<Call>::deserialize(json).map(Self::Call),
            () if has("stream") => Box::<Stream>::deserialize(json).map(Self::Stream),
            () if has("repeat") => Repeat::deserialize(json).map(Self::Repeat),
            () if has("pause_ms") => Pause::deserialize(json).map(Self::Pause),
            () => Event::deserialize(json).map(Self::Event),
        };
        step.map_err(serde::de::Error::custom)
    }
}

/// A call.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Call {
    /// The function.
    #[serde(deserialize_with = "function")]
    pub call: FunctionId,
    /// The arguments, with names for values of earlier replies.
    #[serde(default)]
    pub args: Vec<Json>,
    /// The session.
    #[serde(default = "main_session")]
    pub on: String,
    /// The models that it is made on; all of the sequence unless given.
    #[serde(default)]
    pub only: Option<Vec<Model>>,
    /// The name that the reply's value gets.
    #[serde(rename = "as")]
    pub name: Option<String>,
    /// The code; S_OK unless given.
    pub code: Option<Expected>,
    /// The type of the value, as `I4`, `R8[8]`, `BSTR[]`.
    pub gives: Option<String>,
    /// The value.
    pub is: Option<Json>,
    /// The value that ends a loop of this call.
    pub until: Option<Json>,
    /// The number of repeats; once by default.
    pub times: Option<u32>,
    /// Steps of other sessions while this call waits for its reply.
    #[serde(default)]
    pub during: Vec<Step>,
}

fn main_session() -> String {
    MAIN.to_owned()
}

fn function<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<FunctionId, D::Error> {
    let name = String::deserialize(deserializer)?;
    FunctionId::parse(&name).ok_or_else(|| serde::de::Error::custom(format!("{name} is no function")))
}

impl Call {
    /// Returns the command of an Execute, otherwise the function.
    #[must_use]
    pub fn title(&self) -> String {
        let executes = [FunctionId::CONTROLLER_EXECUTE, FunctionId::ROBOT_EXECUTE].contains(&self.call);
        let command = self.args.get(1).and_then(Json::as_str).filter(|_| executes);
        command.or_else(|| self.call.name()).unwrap_or_default().to_owned()
    }
}

/// A stream of slvMove; cycle k sends
/// `from + k step + wave (1 - cos(2 pi k / period)) / 2 + sine sin(2 pi k / period)`, then `tail`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stream {
    /// The robot.
    pub stream: String,
    /// The number of cycles.
    pub cycles: u32,
    /// The first pose: numbers, or the name of a reply's value.
    pub from: Json,
    /// The change in each cycle.
    #[serde(default)]
    pub step: Vec<f64>,
    /// The height of a wave that starts and ends at rest.
    #[serde(default)]
    pub wave: Vec<f64>,
    /// The amplitude of a sine.
    #[serde(default)]
    pub sine: Vec<f64>,
    /// The cycles of a period; `cycles` unless given.
    pub period: Option<f64>,
    /// Numbers after the pose.
    #[serde(default)]
    pub tail: Vec<Json>,
    /// The IO values that follow the pose in an array of VARIANT; without them the pose is the parameter.
    #[serde(default)]
    pub io: Vec<Json>,
    /// The element type of the pose: R4, R8 or VARIANT; in the last case, whole numbers of `tail` are I4.
    #[serde(default = "doubles")]
    pub numbers: String,
    /// The session.
    #[serde(default = "main_session")]
    pub on: String,
    /// The client's pause after each call, in ms; mode 1 has no other pace.
    #[serde(default)]
    pub pace_ms: u64,
    /// The type of each reply's value.
    pub gives: Option<String>,
    /// The code that ends the stream before its end.
    pub ends: Option<Expected>,
}

fn doubles() -> String {
    "R8".to_owned()
}

/// Steps that are repeated; `"#"` stands for the number of the round, from 0.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Repeat {
    /// The number of repeats.
    pub repeat: u32,
    /// The steps.
    pub steps: Vec<Step>,
}

/// A time without calls.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pause {
    /// The duration on the controller's clock.
    pub pause_ms: u64,
}

/// Something that happens to the controller.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the names are those of scenarios")]
pub struct Event {
    #[serde(default)]
    pub emergency_stop: Option<bool>,
    #[serde(default)]
    pub error: Option<Code>,
}

/// A sequence.
#[derive(Clone, Debug)]
pub struct Sequence {
    /// The first line.
    pub head: Head,
    /// The others.
    pub steps: Vec<Step>,
}

/// Reads all sequences, by the names of their files.
///
/// # Panics
///
/// When a file cannot be read, with its line.
#[must_use]
pub fn sequences() -> Vec<Sequence> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("drivers");
    let entries = fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut files: Vec<_> = entries.map(|entry| entry.expect("an entry of the folder").path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "jsonl"));
    files.sort();
    files.iter().map(|file| sequence(&fs::read_to_string(file).expect("a text"), &file.display().to_string())).collect()
}

/// Reads one sequence.
///
/// # Panics
///
/// When a line is wrong, has an unknown word, or has a word without effect; `place` says where it is from.
#[must_use]
pub fn sequence(text: &str, place: &str) -> Sequence {
    fn read<T: for<'de> Deserialize<'de>>(line: &str, place: &str, number: usize) -> T {
        serde_json::from_str(line).unwrap_or_else(|e| panic!("{place}:{number}: {e}: {line}"))
    }
    let mut lines = text.lines().enumerate();
    let (_, head) = lines.next().unwrap_or_else(|| panic!("{place} is empty"));
    let head: Head = read(head, place, 1);
    let mut check = Check::of(&head);
    let steps = lines.map(|(i, line)| {
        let step = read(line, place, i + 1);
        check.step(&step).unwrap_or_else(|e| panic!("{place}:{}: {e}: {line}", i + 1));
        step
    });
    let steps = steps.collect();
    check.end().unwrap_or_else(|e| panic!("{place}: {e}"));
    Sequence { head, steps }
}

/// Refuses words that no player would understand, or that would have no effect.
struct Check<'a> {
    head: &'a Head,
    /// The names of earlier replies.
    names: BTreeSet<String>,
    /// The titles of the calls.
    titles: BTreeSet<String>,
}

impl<'a> Check<'a> {
    fn of(head: &'a Head) -> Self {
        Self { head, names: BTreeSet::from(["provider".to_owned()]), titles: BTreeSet::new() }
    }

    fn step(&mut self, step: &Step) -> Result<(), String> {
        match step {
            Step::Call(call) => self.call(call),
            Step::Stream(stream) => self.stream(stream),
            Step::Repeat(repeat) => {
                self.names.insert("#".to_owned());
                repeat.steps.iter().try_for_each(|step| self.step(step))
            }
            Step::Pause(_) => Ok(()),
            Step::Event(Event { emergency_stop: None, error: None }) => Err("not a step".into()),
            Step::Event(_) => Ok(()),
        }
    }

    fn call(&mut self, call: &Call) -> Result<(), String> {
        self.session(&call.on)?;
        self.models(call.only.iter().flatten())?;
        self.code(call.code.as_ref())?;
        call.args.iter().chain(&call.is).chain(&call.until).try_for_each(|json| self.value(json))?;
        call.gives.as_deref().map_or(Ok(()), is_type)?;
        if call.until.is_some() && call.times.is_some() {
            return Err("times has no effect with until".into());
        }
        call.during.iter().try_for_each(|step| self.step(step))?;
        self.titles.insert(call.title());
        self.names.extend(call.name.clone());
        Ok(())
    }

    fn stream(&mut self, stream: &Stream) -> Result<(), String> {
        self.session(&stream.on)?;
        self.code(stream.ends.as_ref())?;
        let robot = Json::from(stream.stream.clone());
        [&robot, &stream.from]
            .into_iter()
            .chain(&stream.tail)
            .chain(&stream.io)
            .try_for_each(|json| self.value(json))?;
        stream.gives.as_deref().map_or(Ok(()), is_type)?;
        self.titles.insert("slvMove".to_owned());
        match &*stream.numbers {
            "R4" | "R8" | "VARIANT" => Ok(()),
            other => Err(format!("a pose is not made of {other}")),
        }
    }

    fn session(&self, name: &str) -> Result<(), String> {
        if self.head.sessions.contains_key(name) { Ok(()) } else { Err(format!("no session is called {name}")) }
    }

    /// Refuses models whose programs another model also runs, and models on which the sequence is not run.
    fn models<'m>(&self, models: impl IntoIterator<Item = &'m Model>) -> Result<(), String> {
        let is_played = |model: Model| self.head.models.contains(&model) || self.head.failure(model).is_some();
        let has_effect = |model: &&Model| model.like() == **model && is_played(**model);
        let other = models.into_iter().find(|model| !has_effect(model));
        other.map_or(Ok(()), |model| Err(format!("the sequence is not played on {model:?}")))
    }

    fn code(&self, code: Option<&Expected>) -> Result<(), String> {
        match code {
            Some(Expected::ByModel(codes)) => self.models(codes.keys()),
            Some(Expected::Always(_)) | None => Ok(()),
        }
    }

    /// Refuses names of no reply, and types that are unknown.
    fn value(&self, json: &Json) -> Result<(), String> {
        match json {
            Json::String(text) => match text.strip_prefix('$').or((text == "#").then_some("#")) {
                Some(name) => {
                    let (name, part) = name.split_once('.').unwrap_or((name, "0"));
                    let is_part = part.strip_suffix("..").unwrap_or(part).parse::<usize>().is_ok();
                    let is_known = is_part && self.names.contains(name);
                    if is_known { Ok(()) } else { Err(format!("no reply is called {text}")) }
                }
                None => Ok(()),
            },
            Json::Array(items) => items.iter().try_for_each(|item| self.value(item)),
            Json::Object(typed) => match typed.iter().collect::<Vec<_>>()[..] {
                [(name, json)] => is_element(name).and_then(|()| self.value(json)),
                _ => Err("a value has one type".into()),
            },
            _ => Ok(()),
        }
    }

    fn end(&self) -> Result<(), String> {
        for (model, failure) in &self.head.elsewhere {
            if self.head.models.contains(model) || !self.titles.contains(&failure.at) {
                return Err(format!("{model:?} does not fail at {}", failure.at));
            }
        }
        Ok(())
    }
}

fn is_element(name: &str) -> Result<(), String> {
    let is_known = TYPES.iter().any(|(known, _)| *known == name);
    if is_known { Ok(()) } else { Err(format!("{name} is no type")) }
}

/// Refuses what is not a type as `I4`, `R8[8]` or `BSTR[]`.
fn is_type(gives: &str) -> Result<(), String> {
    let Some((element, count)) = gives.split_once('[') else { return is_element(gives) };
    match count.strip_suffix(']') {
        Some(count) if count.is_empty() || count.parse::<usize>().is_ok() => is_element(element),
        _ => Err(format!("{gives} is no type")),
    }
}

/// Values of earlier replies by name.
pub type Names = BTreeMap<String, Value>;

/// Converts a JSON value as a script language does: a string is BSTR, a whole number I4, any other number R8, a list an array
/// of its elements' type or of VARIANT; `{"R4": 1.5}` names the type.
///
/// # Panics
///
/// When a name or a type is unknown.
#[must_use]
pub fn value(json: &Json, names: &Names) -> Value {
    match json {
        Json::Null => Value::Empty,
        Json::Bool(b) => Value::Bool(*b),
        Json::Number(n) => match n.as_i64().and_then(|n| i32::try_from(n).ok()) {
            Some(n) => Value::I4(n),
            None => Value::R8(n.as_f64().expect("a number").to_bits()),
        },
        Json::String(text) => match text.strip_prefix('$') {
            Some(name) => named(name, names),
            None if text == "#" => named("#", names),
            None => Value::text(text),
        },
        Json::Array(items) => {
            let items: Vec<Value> = items.iter().map(|item| value(item, names)).collect();
            let element = items.first().map_or(VARIANT, Value::vartype);
            let same = element & ARRAY == 0 && items.iter().all(|item| item.vartype() == element);
            Value::Array(if same { element } else { VARIANT }, items)
        }
        Json::Object(typed) => {
            let (name, json) = typed.iter().next().expect("a type");
            let element = element(name);
            match json.as_array() {
                Some(items) if element == VARIANT => {
                    Value::Array(VARIANT, items.iter().map(|item| value(item, names)).collect())
                }
                Some(items) => Value::Array(element, items.iter().map(|item| scalar(element, item)).collect()),
                None => scalar(element, json),
            }
        }
    }
}

/// Looks a value up; `names.0` is the first element of an array, `names.1..` the others.
fn named(name: &str, names: &Names) -> Value {
    let (name, part) = name.split_once('.').unwrap_or((name, ""));
    let value = names.get(name).unwrap_or_else(|| panic!("no reply is called {name}"));
    let (index, rest) = part.strip_suffix("..").map_or((part, false), |index| (index, true));
    match (value, index.parse::<usize>()) {
        (Value::Array(element, items), Ok(index)) if rest => Value::Array(*element, items[index..].to_vec()),
        (Value::Array(_, items), Ok(index)) => items[index].clone(),
        (value, _) => value.clone(),
    }
}

/// The types that files name.
const TYPES: &[(&str, u16)] = &[
    ("EMPTY", 0),
    ("I2", 2),
    ("I4", 3),
    ("R4", 4),
    ("R8", 5),
    ("DATE", 7),
    ("BSTR", 8),
    ("BOOL", 11),
    ("VARIANT", VARIANT),
    ("UI1", 17),
    ("UI4", 19),
];

fn element(name: &str) -> u16 {
    TYPES.iter().find(|(known, _)| *known == name).unwrap_or_else(|| panic!("{name} is no type")).1
}

fn scalar(vartype: u16, json: &Json) -> Value {
    let int = || json.as_i64().unwrap_or_else(|| panic!("{json} is no integer"));
    let float = || json.as_f64().unwrap_or_else(|| panic!("{json} is no number"));
    match vartype {
        2 => Value::I2(int() as i16),
        3 => Value::I4(int() as i32),
        4 => Value::R4((float() as f32).to_bits()),
        5 => Value::R8(float().to_bits()),
        17 => Value::Ui1(int() as u8),
        19 => Value::Ui4(int() as u32),
        other => panic!("no sequence sends the VARTYPE {other} by name"),
    }
}

/// Returns the type of a value as files name it: `I4`, `R8[8]`.
#[must_use]
pub fn type_name(value: &Value) -> String {
    let name = |vartype: u16| TYPES.iter().find(|(_, known)| *known == vartype).map_or("?", |(name, _)| name);
    match value {
        Value::Array(element, items) => format!("{}[{}]", name(*element), items.len()),
        value => name(value.vartype()).to_owned(),
    }
}

impl Stream {
    /// Returns the parameter of slvMove in a cycle.
    ///
    /// # Panics
    ///
    /// When the first pose is not made of numbers.
    #[must_use]
    pub fn parameter(&self, cycle: u32, names: &Names) -> Value {
        let from = numbers(&value(&self.from, names));
        let turn = f64::from(cycle) / self.period.unwrap_or(f64::from(self.cycles)) * std::f64::consts::TAU;
        let at = |part: &[f64], axis: usize| part.get(axis).copied().unwrap_or(0.0);
        let pose = from.iter().enumerate().map(|(axis, from)| {
            from + at(&self.step, axis) * f64::from(cycle)
                + at(&self.wave, axis) * (1.0 - turn.cos()) / 2.0
                + at(&self.sine, axis) * turn.sin()
        });
        let numbers = element(&self.numbers);
        let own = if numbers == VARIANT { element("R8") } else { numbers };
        let tail = self.tail.iter().map(|json| if numbers == VARIANT { value(json, names) } else { scalar(own, json) });
        let pose = Value::Array(numbers, pose.map(|n| scalar(own, &n.into())).chain(tail).collect());
        if self.io.is_empty() {
            return pose;
        }
        Value::Array(VARIANT, std::iter::once(pose).chain(self.io.iter().map(|io| value(io, names))).collect())
    }
}

/// Reads numbers of any type.
fn numbers(value: &Value) -> Vec<f64> {
    let number = |value: &Value| match value {
        Value::I4(n) => f64::from(*n),
        Value::R4(bits) => f64::from(f32::from_bits(*bits)),
        Value::R8(bits) => f64::from_bits(*bits),
        other => panic!("{other:?} is no number"),
    };
    match value {
        Value::Array(_, items) => items.iter().map(number).collect(),
        other => panic!("{other:?} is no pose"),
    }
}
