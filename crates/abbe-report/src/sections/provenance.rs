//! Where the results come from.

use crate::html::{Cell, details, escape, paragraph, table};
use crate::run::Run;

/// The section: recipe, files with their hashes, plugins, version.
pub fn provenance(run: &Run) -> String {
    let Some(record) = &run.record else {
        return paragraph("This is a calibration without the record of its run.") + &data(run);
    };
    let mut html = paragraph(&format!("Abbe {}, recipe {}.", record.version, record.recipe));
    html.push_str(&match &run.recipe {
        Some(text) => details("Text of the recipe", false, &format!("<pre>{}</pre>\n", escape(text))),
        None => paragraph("The recipe is not there any more as it was; its hash is below."),
    });
    let rows = record.inputs.iter().map(|file| vec![Cell::text(&file.file), hash(&file.sha256)]);
    html.push_str(&details(
        &format!("{} files that were read", record.inputs.len()),
        false,
        &table("Files that were read, the recipe first", &["file", "SHA-256"], &rows.collect::<Vec<_>>()),
    ));
    let rows = record.plugins.iter().map(|plugin| {
        let [kind, name] = [plugin.kind.key(), plugin.name.as_str()].map(Cell::text);
        vec![name, kind, Cell::text(&plugin.version), Cell::text(&plugin.origin)]
    });
    let plugins = table("Plugins", &["name", "kind", "version", "origin"], &rows.collect::<Vec<_>>());
    html + &details(&format!("{} plugins", record.plugins.len()), false, &plugins)
}

fn hash(sha256: &str) -> Cell {
    Cell::Html(format!("<code>{}</code>", escape(sha256)))
}

/// The measurements that calibrations name themselves.
fn data(run: &Run) -> String {
    let files = run.fits.iter().flat_map(|fit| &fit.calibration.data);
    let rows =
        files.map(|record| vec![Cell::text(&record.file), hash(record.sha256.as_deref().unwrap_or("not known"))]);
    let rows: Vec<Vec<Cell>> = rows.collect();
    if rows.is_empty() { String::new() } else { table("Measurements", &["file", "SHA-256"], &rows) }
}
