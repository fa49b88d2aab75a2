//! The header for plugins in C and C++, made of the Rust source of the interface.

use std::fs;

use cbindgen::{Builder, Config, DocumentationStyle, ExportConfig, Language, Style};

use crate::{Outcome, root};

const SOURCE: &str = "crates/abbe-plugin/src/abi.rs";
const HEADER: &str = "crates/abbe-plugin/include/abbe_plugin.h";

const FIRST: &str = "\
/* The plugin interface of Abbe, for plugins in C and C++.
 *
 * Made of crates/abbe-plugin/src/abi.rs by `cargo xtask header`; not to be edited. All text is UTF-8; questions and answers
 * are JSON.
 *
 * Rules: new fields are only added at the end of a structure, and every structure has its size. Arguments of a call are lent
 * until the call returns. Every function may be called from several threads at once. No exception may leave a function. */
#ifndef ABBE_PLUGIN_H
#define ABBE_PLUGIN_H";

/// What a library exports; Rust declares it in the macro `export!`.
const LAST: &str = "
/* The function that a library exports. Its table stays valid until the process ends; null refuses to work with this program. */
#ifdef __cplusplus
extern \"C\"
#endif
#if defined(_WIN32)
__declspec(dllexport)
#elif defined(__GNUC__)
__attribute__((visibility(\"default\")))
#endif
const AbbeLibrary *abbe_plugin(const AbbeHost *host);

/* A text from a string literal or an array of characters that ends with zero. */
#define ABBE_TEXT(literal) { literal, sizeof(literal) - 1 }

#endif";

/// The header as the source has it.
fn generated() -> Outcome<String> {
    let config = Config {
        language: Language::C,
        style: Style::Both,
        cpp_compat: true,
        header: Some(FIRST.to_owned()),
        trailer: Some(LAST.to_owned()),
        no_includes: true,
        sys_includes: vec!["stdint.h".to_owned()],
        // Declared first: its first use is in a list of arguments, where C would declare another structure.
        after_includes: Some("\nstruct AbbeReply;".to_owned()),
        documentation_style: DocumentationStyle::C99,
        usize_is_size_t: true,
        line_length: 120,
        tab_width: 4,
        export: ExportConfig {
            // All other types follow from it.
            include: vec!["AbbeEntry".to_owned()],
            exclude: vec!["ENTRY".to_owned()],
            ..ExportConfig::default()
        },
        ..Config::default()
    };
    let bindings = Builder::new().with_config(config).with_src(root().join(SOURCE)).generate();
    let bindings = bindings.map_err(|error| format!("{SOURCE}: {error}"))?;
    let mut text = Vec::new();
    bindings.write(&mut text);
    let text = String::from_utf8(text).map_err(|error| format!("{SOURCE}: {error}"))?;
    // C has no links of the documentation.
    Ok(text.replace("[`", "`").replace("`]", "`"))
}

/// Writes the header.
pub fn write() -> Outcome {
    fs::write(root().join(HEADER), generated()?).map_err(|error| format!("{HEADER}: {error}"))
}

/// Whether the header is as the source has it.
pub fn check() -> Outcome {
    let committed = fs::read_to_string(root().join(HEADER)).map_err(|error| format!("{HEADER}: {error}"))?;
    match committed.replace("\r\n", "\n") == generated()? {
        true => Ok(()),
        false => Err(format!("{HEADER} is not what {SOURCE} says: `cargo xtask header` writes it anew")),
    }
}
