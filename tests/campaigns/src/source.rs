//! Recipes of the repository with the files that they read, to be copied into a folder and changed there.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// A recipe with the files that it reads, by their paths in the folder of recipes.
#[derive(Clone)]
pub struct Source {
    pub name: String,
    pub files: BTreeMap<PathBuf, Vec<u8>>,
}

/// The folder of recipes.
pub fn pipelines() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines")
}

impl Source {
    pub fn read(name: &str) -> Self {
        let folder = pipelines();
        let recipe = PathBuf::from(format!("{name}.yaml"));
        let text = fs::read_to_string(folder.join(&recipe)).expect("the recipe");
        let ends = |letter: char| letter.is_whitespace() || ",]}\"'".contains(letter);
        let paths = text.match_indices("data/").map(|(at, _)| text[at..].split(ends).next().unwrap_or_default());
        let mut files = BTreeMap::from([(recipe, text.clone().into_bytes())]);
        for path in paths.map(Path::new) {
            // A pattern stands for files of its folder.
            let folder_of = path.parent().expect("a path in the folder of data");
            let all = fs::read_dir(folder.join(folder_of)).expect("the folder of data");
            let all = all.map(|entry| folder_of.join(entry.expect("an entry").file_name()));
            let is_named = |file: &PathBuf| *file == path || path.to_string_lossy().contains('*');
            for file in all.filter(is_named).filter(|file| folder.join(file).is_file()) {
                files.insert(file.clone(), fs::read(folder.join(&file)).expect("a file of data"));
            }
        }
        Self { name: name.to_owned(), files }
    }

    /// The recipe.
    pub fn recipe(&self) -> PathBuf {
        PathBuf::from(format!("{}.yaml", self.name))
    }

    pub fn write(&self, folder: &Path) {
        for (file, content) in &self.files {
            let file = folder.join(file);
            fs::create_dir_all(file.parent().expect("a folder")).expect("the folder can be made");
            fs::write(file, content).expect("the file can be written");
        }
    }
}
