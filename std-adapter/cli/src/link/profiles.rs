//! Profiles: the connection to a controller under a name, in `~/.config/bcap/config.toml`.
//!
//! ```toml
//! [profile.cell1]
//! address = "tcp:192.168.0.1"
//! model = "rc9"                # as for --provider
//! machine = "localhost"         # the machine and the option of Controller_Connect
//! option = ""
//! rac_port = 5006
//! timeout = "3s"
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{env, fs, io};

use bcap_backup::local_files;
use bcap_capture::duration;
use bcap_std::Model;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer};

use crate::failure::{Failure, cannot, of_file};
use crate::link::address;

/// The connection to a controller.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Profile {
    /// As it is written.
    #[serde(default, deserialize_with = "address")]
    pub(crate) address: Option<String>,
    #[serde(default, alias = "model", deserialize_with = "provider")]
    pub(crate) provider: Option<String>,
    pub(crate) machine: Option<String>,
    pub(crate) option: Option<String>,
    pub(crate) rac_port: Option<u16>,
    #[serde(default, deserialize_with = "timeout")]
    pub(crate) timeout: Option<Duration>,
}

/// Reads a text that must fit.
fn checked<'de, D: Deserializer<'de>, T>(
    text: D,
    check: impl FnOnce(&str) -> Result<T, String>,
) -> Result<Option<T>, D::Error> {
    check(&String::deserialize(text)?).map(Some).map_err(D::Error::custom)
}

fn address<'de, D: Deserializer<'de>>(text: D) -> Result<Option<String>, D::Error> {
    checked(text, |text| {
        address::bcap(Some(text), None).map(|_| text.to_owned()).map_err(|failure| failure.to_string())
    })
}

fn timeout<'de, D: Deserializer<'de>>(text: D) -> Result<Option<Duration>, D::Error> {
    checked(text, |text| duration::parse(text).map_err(|error| format!("{text}: {error}")))
}

fn provider<'de, D: Deserializer<'de>>(name: D) -> Result<Option<String>, D::Error> {
    checked(name, |name| match provider_of(name) {
        provider if provider.contains('.') => Ok(provider.to_owned()),
        _ => Err(format!("{name}: write a model (rc8, rc9, cobotta, cobotta-pro) or the name of a provider")),
    })
}

/// Returns the provider of a model, or the name of a provider as it is.
pub(crate) fn provider_of(name: &str) -> &str {
    match name.to_ascii_lowercase().as_str() {
        "rc8" | "rc8a" | "cobotta" => Model::Rc8.provider(),
        "rc9" | "cobotta-pro" => Model::Rc9.provider(),
        _ => name,
    }
}

/// All profiles of the file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    #[serde(default)]
    profile: BTreeMap<String, Profile>,
}

/// The file with the profiles.
#[derive(Debug)]
pub(crate) struct Profiles {
    pub(crate) path: PathBuf,
    pub(crate) by_name: BTreeMap<String, Profile>,
}

impl Profiles {
    /// Reads the file; without a file there are no profiles.
    pub(crate) fn read() -> Result<Self, Failure> {
        let path = path()
            .ok_or_else(|| Failure::Input("the folder of settings is not known: set XDG_CONFIG_HOME or HOME".into()))?;
        let by_name = match fs::read_to_string(&path) {
            Ok(text) => parse(&text, &path)?,
            Err(error) if error.kind() == io::ErrorKind::NotFound => BTreeMap::new(),
            Err(error) => return Err(cannot("read", &path)(error)),
        };
        Ok(Self { path, by_name })
    }

    /// Returns a profile.
    pub(crate) fn find(&self, name: &str) -> Result<&Profile, Failure> {
        self.by_name.get(name).ok_or_else(|| {
            let path = self.path.display();
            let names: Vec<&str> = self.by_name.keys().map(String::as_str).collect();
            Failure::Input(match names.as_slice() {
                [] => {
                    format!("the profile {name} does not exist: {path} has no profiles; write [profile.{name}] there")
                }
                names => format!("the profile {name} does not exist; {path} has {}", names.join(", ")),
            })
        })
    }
}

/// Adds the provider of the controller to a profile without one, so that the next command connects with it right away.
pub(crate) fn remember(name: &str, provider: &str) -> Result<(), Failure> {
    let path = Profiles::read()?.path;
    let text = fs::read_to_string(&path).map_err(of_file(&path))?;
    let header = format!("[profile.{name}]\n");
    let new = text.replacen(&header, &format!("{header}provider = {provider:?}\n"), 1);
    // a profile may be written in another way
    if parse(&new, &path)?.get(name).is_none_or(|profile| profile.provider.is_none()) {
        return Err(Failure::Input(format!("{} does not have the line {}", path.display(), header.trim_end())));
    }
    local_files::write(&path, new.as_bytes(), true).map_err(Failure::from)
}

/// Returns the file, `$XDG_CONFIG_HOME/bcap/config.toml` or `~/.config/bcap/config.toml`.
fn path() -> Option<PathBuf> {
    let folder = |name: &str| env::var_os(name).filter(|folder| !folder.is_empty()).map(PathBuf::from);
    let folder = folder("XDG_CONFIG_HOME")
        .or_else(|| folder("HOME").map(|home| home.join(".config")))
        .or_else(|| folder("APPDATA"));
    Some(folder?.join("bcap").join("config.toml"))
}

/// Parses the file. An error begins with the file and the line.
fn parse(text: &str, path: &Path) -> Result<BTreeMap<String, Profile>, Failure> {
    let wrong = |at: usize, what: &str| {
        let line = text.get(..at).map_or(1, |before| before.matches('\n').count() + 1);
        Failure::Input(format!("{}, line {line}: {what}", path.display()))
    };
    let content: Content =
        toml::from_str(text).map_err(|error| wrong(error.span().map_or(0, |span| span.start), error.message()))?;
    Ok(content.profile)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_file_is_named_with_the_line() {
        for (text, expected) in [
            ("[profile.a]\naddress = \"http://x\"", "config.toml, line 2: http://x: write tcp:HOST"),
            ("[profile.a]\n\nadress = \"x\"", "config.toml, line 3: unknown field `adress`"),
            ("[profile.a]\nmodel = \"rc7\"", "config.toml, line 2: rc7: write a model (rc8, rc9, cobotta"),
            ("[profile.a]\nprovider = \"\"", "config.toml, line 2: : write a model"),
            ("[profile.a]\nrac_port = 70000", "config.toml, line 2: "),
            ("[profile.a]\ntimeout = \"3h\"", "config.toml, line 2: 3h: write a time"),
            ("\n[profile.a\n", "config.toml, line 2: "),
            ("[profile.a]\nmodel = \"rc8\"\nprovider = \"x.y\"", "config.toml, line 1: duplicate field `provider`"),
        ] {
            let Err(Failure::Input(message)) = parse(text, Path::new("config.toml")) else { panic!("{text}") };
            assert!(message.starts_with(expected), "{message}");
        }
    }

    #[test]
    fn a_profile_has_the_provider_of_its_model() {
        let profiles =
            parse("[profile.a]\nmodel = \"RC9\"\ntimeout = \"2s\"\n[profile.b]\nprovider = \"x.y\"", Path::new(""));
        let profiles = profiles.unwrap();
        assert_eq!(profiles["a"].provider.as_deref(), Some("CaoProv.DENSO.VRC9"));
        assert_eq!(
            (profiles["a"].timeout, profiles["b"].provider.as_deref()),
            (Some(Duration::from_secs(2)), Some("x.y"))
        );
    }
}
