//! The known facts about a result code.

use bcap_core::hresult::HResult;

/// Returns the facts about a result code, with the title of each.
pub fn facts(code: HResult) -> impl Iterator<Item = (&'static str, String)> {
    let same = code.listed();
    let level = code.level().zip(code.effect());
    [
        ("same as", (same != code).then(|| format!("{same}: the bit that makes 8 to C has no meaning"))),
        ("meaning", code.meaning().map(str::to_owned)),
        ("axis", code.axis().map(|axis| axis.to_string())),
        ("level", level.map(|(level, effect)| format!("{level} of 0 to 5: {effect}"))),
        ("part", code.part().map(str::to_owned)),
        ("system", code.os_error().map(|number| format!("error {number} of the operating system that answered"))),
        ("cause", code.cause().map(str::to_owned)),
        ("what to do", code.hint().map(|hint| hint.to_string())),
        ("returned by", code.functions().map(str::to_owned)),
        ("source", code.source().map(str::to_owned)),
    ]
    .into_iter()
    .filter_map(|(title, text)| Some((title, text?)))
}
