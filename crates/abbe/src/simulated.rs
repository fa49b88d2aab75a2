//! What was simulated, for a terminal.

use std::path::Path;

use abbe_engine::Simulated;

/// What was simulated, and how to go on.
pub fn text(simulated: &Simulated, out: &Path) -> String {
    let mut text = "Simulated\n".to_owned();
    for file in &simulated.data {
        text.push_str(&format!("  {}: {} rows measured, {} copied\n", file.file.display(), file.measured, file.copied));
        if file.copied > 0 {
            let readers: Vec<&str> = file.read_by.iter().map(String::as_str).collect();
            let copied = "copied rows are as they were: no artefact takes them";
            text.push_str(&format!("    {copied}. Read by {}\n", readers.join(", ")));
        }
    }
    for file in &simulated.not_simulated {
        let readers: Vec<&str> = file.read_by.iter().map(String::as_str).collect();
        let readers = if readers.is_empty() { "no stage".to_owned() } else { format!("{} only", readers.join(", ")) };
        text.push_str(&format!("  not simulated: {} (read by {readers})\n", file.file.display()));
    }
    text.push_str("\nVaried\n");
    simulated.varied.iter().for_each(|line| text.push_str(&format!("  {line}\n")));
    let recipe = out.join(&simulated.recipe);
    text.push_str(&format!("\nWritten: {}\nGo on with: abbe run {}\n", out.display(), recipe.display()));
    text
}
