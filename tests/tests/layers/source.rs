//! Reads the files of a crate: its modules, and the items of others that each of them names.
//!
//! A file is read as tokens, so that comments and strings do not count and the bodies of macros do. Code for tests
//! (`#[cfg(test)]`, `#[cfg(all(test, ...))]`) is left out.

use std::collections::BTreeMap;
use std::fs;
use std::iter::Peekable;
use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, Group, TokenStream, TokenTree, token_stream};

/// Names from the root of a crate, or from a module.
pub(crate) type Names = Vec<String>;

/// A `use` of a name, or another mention of a path.
#[derive(Debug)]
pub(crate) struct Mention {
    /// The module that it is in.
    pub(crate) scope: Names,
    pub(crate) path: Names,
}

/// A name that a module has by `use`.
#[derive(Debug)]
pub(crate) struct Import {
    pub(crate) path: Names,
    /// `pub use`: others take it from here.
    pub(crate) is_reexport: bool,
}

/// The modules of a crate and the names in them.
#[derive(Debug, Default)]
pub(crate) struct Source {
    /// The file of each module, inline ones included, relative to `src`.
    pub(crate) modules: BTreeMap<Names, String>,
    pub(crate) mentions: Vec<Mention>,
    /// By module and local name.
    imports: BTreeMap<(Names, String), Import>,
    /// All identifiers of each module outside of `use`: they show whether a module uses what it re-exports.
    pub(crate) identifiers: Vec<(Names, String)>,
}

impl Source {
    /// Reads a crate from its root file, `src/lib.rs` or `src/main.rs`.
    pub(crate) fn read(src: &Path) -> Self {
        let mut source = Self::default();
        let root = ["lib.rs", "main.rs"].into_iter().find(|name| src.join(name).is_file()).expect("a root file");
        source.file(src, Path::new(root), &Names::new());
        source
    }

    /// Returns the item that a module imports under a name.
    pub(crate) fn import(&self, module: &[String], name: &str) -> Option<&Import> {
        self.imports.get(&(module.to_vec(), name.to_owned()))
    }

    fn file(&mut self, src: &Path, file: &Path, scope: &Names) {
        let text = fs::read_to_string(src.join(file)).unwrap_or_else(|e| panic!("{}: {e}", src.join(file).display()));
        let tokens: TokenStream = text.parse().unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        self.modules.insert(scope.clone(), file.display().to_string());
        self.tokens(tokens, scope, &mut |source, child| {
            let child_file = child_file(src, child);
            source.file(src, &child_file, child);
        });
    }

    /// Reads tokens of a module; `load` reads the file of a module that is declared there.
    fn tokens(&mut self, tokens: TokenStream, scope: &Names, load: &mut dyn FnMut(&mut Self, &Names)) {
        let mut tokens = tokens.into_iter().peekable();
        let (mut is_public, mut after) = (false, ' ');
        while let Some(token) = tokens.next() {
            match token {
                TokenTree::Punct(punct) if punct.as_char() == '#' => {
                    if is_cfg_test(tokens.peek()) {
                        skip_item(&mut tokens);
                    }
                }
                TokenTree::Ident(ident) => match ident.to_string().as_str() {
                    "use" if after != '.' => self.use_item(&mut tokens, scope, is_public),
                    "mod" => self.mod_item(&mut tokens, scope, load),
                    "pub" => {
                        tokens.next_if(is_restriction);
                        is_public = true;
                        continue;
                    }
                    name => {
                        self.identifiers.push((scope.clone(), name.to_owned()));
                        let path = rest_of_path(name, &mut tokens);
                        if path.len() > 1 && after != '.' {
                            self.mentions.push(Mention { scope: scope.clone(), path });
                        }
                    }
                },
                TokenTree::Group(group) => self.tokens(group.stream(), scope, load),
                TokenTree::Punct(punct) => {
                    after = punct.as_char();
                    continue;
                }
                TokenTree::Literal(_) => {}
            }
            (is_public, after) = (false, ' ');
        }
    }

    fn mod_item(&mut self, tokens: &mut Tokens, scope: &Names, load: &mut dyn FnMut(&mut Self, &Names)) {
        let Some(TokenTree::Ident(name)) = tokens.next() else { return };
        let child = child(scope, &name.to_string());
        match tokens.next() {
            Some(TokenTree::Group(body)) => {
                self.modules.insert(child.clone(), self.modules[scope].clone());
                self.tokens(body.stream(), &child, load);
            }
            _ => load(self, &child),
        }
    }

    fn use_item(&mut self, tokens: &mut Tokens, scope: &Names, is_reexport: bool) {
        let tree: TokenStream = tokens.take_while(|token| punct(token) != Some(';')).collect();
        for (path, alias) in use_tree(&Names::new(), tree) {
            self.imports.insert((scope.clone(), alias), Import { path: path.clone(), is_reexport });
            if !is_reexport {
                self.mentions.push(Mention { scope: scope.clone(), path });
            }
        }
    }
}

/// Returns the path of a module in another.
pub(crate) fn child(module: &[String], name: &str) -> Names {
    [module, &[name.to_owned()]].concat()
}

type Tokens = Peekable<token_stream::IntoIter>;

/// Where the file of a module is: `a/b.rs` or `a/b/mod.rs`.
fn child_file(src: &Path, module: &Names) -> PathBuf {
    let folder: PathBuf = module.iter().collect();
    let file = folder.with_extension("rs");
    if src.join(&file).is_file() { file } else { folder.join("mod.rs") }
}

fn punct(token: &TokenTree) -> Option<char> {
    match token {
        TokenTree::Punct(punct) => Some(punct.as_char()),
        _ => None,
    }
}

fn is_cfg_test(attribute: Option<&TokenTree>) -> bool {
    let Some(TokenTree::Group(attribute)) = attribute else { return false };
    let text = attribute.stream().to_string().replace(' ', "");
    text == "cfg(test)" || text.starts_with("cfg(all(test,")
}

/// Whether this is the `(crate)` of `pub(crate)`, which does not count as a mention of the module.
fn is_restriction(token: &TokenTree) -> bool {
    let TokenTree::Group(group) = token else { return false };
    let first = group.stream().into_iter().next().map(|token| token.to_string());
    first.is_some_and(|first| ["crate", "super", "self", "in"].contains(&first.as_str()))
}

/// Skips the rest of an attribute and the item after it.
fn skip_item(tokens: &mut Tokens) {
    let mut is_use = false;
    for token in tokens.by_ref().skip(1) {
        match &token {
            TokenTree::Ident(ident) => is_use |= ident == "use",
            TokenTree::Group(group) if group.delimiter() == Delimiter::Brace && !is_use => return,
            token if punct(token) == Some(';') => return,
            _ => {}
        }
    }
}

/// Reads `::name::name` after the first name of a path.
fn rest_of_path(first: &str, tokens: &mut Tokens) -> Names {
    let mut path = vec![first.to_owned()];
    while tokens.next_if(|token| punct(token) == Some(':')).is_some() {
        if tokens.next_if(|token| punct(token) == Some(':')).is_none() {
            break;
        }
        match tokens.next_if(|token| matches!(token, TokenTree::Ident(_))) {
            Some(name) => path.push(name.to_string()),
            None => break,
        }
    }
    path
}

/// Returns the paths of a `use`, each with its local name. A glob is the path of something in the module.
fn use_tree(prefix: &Names, tree: TokenStream) -> Vec<(Names, String)> {
    let (mut path, mut alias) = (prefix.clone(), None);
    let mut tokens = tree.into_iter();
    while let Some(token) = tokens.next() {
        match token {
            TokenTree::Ident(name) if name == "as" => alias = tokens.next().map(|name| name.to_string()),
            // `a::{self}` is `a`
            TokenTree::Ident(name) if name == "self" && !path.is_empty() => {}
            TokenTree::Ident(name) => path.push(name.to_string()),
            TokenTree::Group(group) => return use_branches(&path, &group),
            token if punct(&token) == Some('*') => path.push("*".into()),
            _ => {}
        }
    }
    alias.or_else(|| path.last().cloned()).map(|alias| (path, alias)).into_iter().collect()
}

/// Returns the paths of `{a, b::c}`.
fn use_branches(prefix: &Names, group: &Group) -> Vec<(Names, String)> {
    let tokens: Vec<_> = group.stream().into_iter().collect();
    let branches = tokens.split(|token| punct(token) == Some(','));
    let branches = branches.filter(|branch| !branch.is_empty());
    branches.flat_map(|branch| use_tree(prefix, branch.iter().cloned().collect())).collect()
}
