//! The header for C is that of the program.

use std::process::Command;

use abbe_plugin::abi;

use crate::support::{read, root, temporary, write};

/// C assertions that structures of the header are as the program has them.
macro_rules! layouts {
    ($($structure:ident { $($field:ident),* $(,)? })*) => {{
        let mut text = String::new();
        $(
            let size = size_of::<abi::$structure>();
            text.push_str(&format!("_Static_assert(sizeof({0}) == {size}, \"{0}\");\n", stringify!($structure)));
            $(
                let offset = std::mem::offset_of!(abi::$structure, $field);
                let (name, field) = (stringify!($structure), stringify!($field));
                text.push_str(&format!("_Static_assert(offsetof({name}, {field}) == {offset}, \"{name}.{field}\");\n"));
            )*
        )*
        text
    }};
}

#[test]
fn the_header_is_that_of_the_program() {
    let mut text = "#include <stddef.h>\n#include \"abbe_plugin.h\"\n".to_owned();
    text.push_str(&layouts! {
        AbbeText { data, length }
        AbbeObject { table, handle }
        AbbeTable { size, retain, release, call, poses, equations }
        AbbeQuestion { size, text, objects, object_count }
        AbbeReply { size, context, text, object }
        AbbeVariable { kind, index }
        AbbePoses {
            size, statuses, status_count, values, value_count, wanted, wanted_count, pose_count, positions, orientations,
            position_derivatives, rotation_derivatives,
        }
        AbbeRows { size, rows, row_count, positions, orientations, pose_count, own, own_count, inputs, input_count }
        AbbeEquations { size, context, equation, position, rotation, own, input }
        AbbePlugin { size, kind, name, about, schema, example, create }
        AbbeLibrary { abi_major, abi_minor, size, name, version, plugins, plugin_count }
        AbbeHost { abi_major, abi_minor, size, log }
    });
    // Every constant and every structure of the source.
    let source = read(&root().join("crates/abbe-plugin/src/abi.rs"));
    let constants = source.lines().filter_map(|line| line.strip_prefix("pub const ABBE_")?.split_once(": u32 = "));
    let constants: Vec<(&str, &str)> = constants.collect();
    assert!(constants.len() > 30, "{constants:?}");
    for (name, value) in constants {
        let value = value.trim_end_matches(';');
        text.push_str(&format!("_Static_assert(ABBE_{name} == {value}, \"ABBE_{name}\");\n"));
    }
    for structure in source.lines().filter_map(|line| line.strip_prefix("pub struct ")) {
        let name = structure.trim_end_matches(" {");
        assert!(text.contains(&format!("sizeof({name})")), "{name} is not compared");
    }
    let folder = temporary();
    let file = folder.path().join("header.c");
    write(&file, &text);
    for (compiler, language) in [("cc", "c"), ("c++", "c++")] {
        let mut command = Command::new(compiler);
        command.args(["-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-x", language]);
        command.arg("-I").arg(root().join("crates/abbe-plugin/include"));
        if language == "c++" {
            command.arg("-D_Static_assert=static_assert");
        }
        let checked = command.arg(&file).output().expect("the compiler runs");
        assert!(checked.status.success(), "{language}: {}", String::from_utf8_lossy(&checked.stderr));
    }
}
