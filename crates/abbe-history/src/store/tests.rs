use abbe_core::{FitReport, ModelRecord, NamedCovariance, Status};

use super::*;
use crate::schema::{APPLICATION, SCHEMA_VERSION, first_version, version};
use rusqlite::Connection;
use serde_json::json;

fn connection(history: &History) -> &Connection {
    match &history.kept {
        Kept::File(file) => &file.connection,
        #[cfg(feature = "postgres")]
        Kept::Server(_) => panic!("a file was expected"),
    }
}

fn entry(week: usize) -> Entry {
    let known = abbe_core::Estimated {
        name: "EC0Y".into(),
        value: 1e-6 * week as f64,
        unit: "rad".into(),
        standard_uncertainty: 1e-6,
        status: Status::Estimated,
    };
    let calibration = Calibration {
        abbe_calibration: abbe_core::CALIBRATION_FORMAT,
        estimate: "weekly".into(),
        model: ModelRecord { plugin: "serial-chain".into(), settings: json!({ "name": "mill" }) },
        parameters: vec![known],
        artefacts: Vec::new(),
        covariance: NamedCovariance { order: vec!["EC0Y".into()], rows: vec![vec![1e-12]] },
        inputs: None,
        data: Vec::new(),
        outliers: Vec::new(),
        fit: FitReport::without_rows(1),
        uncertainty: None,
        monte_carlo: None,
        group: None,
    };
    let stored = Stored {
        machine: format!("mill {}", week % 2),
        label: week.to_string(),
        at: week as f64,
        unit: "week".into(),
        calibration,
    };
    Entry {
        recipe: "weekly".into(),
        calibrations: vec![stored],
        verdicts: Vec::new(),
        evidence: json!({ "inputs": [] }),
    }
}

#[test]
fn what_is_added_comes_back_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plant.sqlite");
    let mut history = History::open(&path).unwrap();
    for week in [3, 1, 2] {
        assert!(matches!(history.add(&entry(week)).unwrap(), Added::New(_)));
    }
    assert_eq!(history.add(&entry(1)).unwrap(), Added::Known(2));
    assert_eq!(history.entries().unwrap().len(), 3);
    assert_eq!(history.entry(2).unwrap(), Some(entry(1)));
    assert_eq!(history.entry(9).unwrap(), None);
    assert_eq!(history.machines().unwrap(), [("mill 0".to_owned(), 1), ("mill 1".to_owned(), 2)]);
    let of_one = Filter { machine: Some("mill 1".into()), entry: None };
    let labels: Vec<String> =
        history.calibrations(&of_one).unwrap().into_iter().map(|(_, stored)| stored.label).collect();
    assert_eq!(labels, ["1", "3"]);
    // What is read is what is there, in another process as well.
    assert_eq!(History::read(&path).unwrap().entry(3).unwrap(), Some(entry(2)));
}

#[test]
fn nothing_stored_can_change() {
    let folder = tempfile::tempdir().unwrap();
    let mut history = History::open(&folder.path().join("plant.sqlite")).unwrap();
    history.add(&entry(1)).unwrap();
    for statement in [
        "UPDATE entry SET recipe = 'x'",
        "DELETE FROM entry",
        "UPDATE calibration SET at = 0",
        "DELETE FROM calibration",
    ] {
        let refused = connection(&history).execute_batch(statement).unwrap_err().to_string();
        assert!(refused.contains("of a history"), "{refused}");
    }
    assert_eq!(history.entry(1).unwrap(), Some(entry(1)));
}

/// A disk that turns a digit, or another program: the hash of the entry tells it.
#[test]
fn an_entry_that_was_changed_is_told() {
    for statement in [
        "UPDATE entry SET recipe = 'other'",
        "UPDATE calibration SET machine = 'other'",
        "UPDATE calibration SET content = replace(content, '0', '1')",
        "UPDATE calibration SET content = replace(content, 'estimated', 'esteemed')",
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.sqlite");
        let mut history = History::open(&path).unwrap();
        assert_eq!(history.add(&entry(1)).unwrap(), Added::New(1));
        history.verify([1]).unwrap();
        let raw = connection(&history);
        let mut asked = raw.prepare("SELECT name FROM sqlite_master WHERE type = 'trigger'").unwrap();
        let triggers: Vec<String> = asked.query_map([], |row| row.get(0)).unwrap().map(Result::unwrap).collect();
        triggers.iter().for_each(|name| raw.execute_batch(&format!("DROP TRIGGER {name}")).unwrap());
        assert!(raw.execute(statement, []).unwrap() > 0, "{statement}");
        drop(asked);
        for told in [history.entry(1).err(), history.verify([1]).err(), history.add(&entry(1)).err()] {
            assert!(told.unwrap().message.contains("entry 1"), "{statement}");
        }
        let all = history.calibrations(&Filter { machine: None, entry: None });
        if statement.contains("esteemed") {
            let told = all.unwrap_err().message;
            assert!(told.contains("history.sqlite") && told.contains("entry 1"), "{told}");
        }
    }
}

#[test]
fn an_older_version_is_migrated_and_a_later_one_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.sqlite");
    let old = Connection::open(&path).unwrap();
    old.execute_batch(first_version()).unwrap();
    old.pragma_update(None, "application_id", APPLICATION).unwrap();
    old.pragma_update(None, "user_version", 1).unwrap();
    old.execute_batch("INSERT INTO entry (sha256, recipe, verdicts, evidence) VALUES ('a', 'old', '[]', '{}')")
        .unwrap();
    drop(old);
    // A reader changes nothing; a writer brings it up to date and keeps what is there.
    assert_eq!(History::read(&path).unwrap().entries().unwrap().len(), 1);
    let mut history = History::open(&path).unwrap();
    assert_eq!(version(connection(&history)).unwrap(), SCHEMA_VERSION);
    history.add(&entry(1)).unwrap();
    let recipes: Vec<String> = history.entries().unwrap().into_iter().map(|(_, _, recipe)| recipe).collect();
    assert_eq!(recipes, ["old", "weekly"]);
    connection(&history).pragma_update(None, "user_version", SCHEMA_VERSION + 1).unwrap();
    let refused = History::open(&path).err().unwrap();
    assert!(refused.message.contains("version 3"), "{refused}");
}

#[test]
fn other_files_stay_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("notes.txt");
    std::fs::write(&text, "not a data base, but long enough to be taken for the head of one by somebody").unwrap();
    assert!(History::open(&text).err().unwrap().message.contains("is no history"));
    assert!(std::fs::read_to_string(&text).unwrap().starts_with("not a data base"));
    let other = folder.path().join("other.sqlite");
    Connection::open(&other).unwrap().execute_batch("CREATE TABLE x (y)").unwrap();
    assert!(History::open(&other).err().unwrap().message.contains("something else"));
    let empty = folder.path().join("empty.sqlite");
    Connection::open(&empty).unwrap().pragma_update(None, "user_version", 1).unwrap();
    assert!(History::open(&empty).err().unwrap().message.contains("something else"));
    assert!(History::read(&folder.path().join("absent")).err().unwrap().message.contains("does not exist"));
}

/// SQLite replays and removes what has the name of a journal of a history; a file of somebody else is none.
#[test]
fn a_file_with_the_name_of_a_journal_stays() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("plant.sqlite");
    drop(History::open(&path).unwrap());
    for ending in ["-journal", "-wal"] {
        let journal = folder.path().join(format!("plant.sqlite{ending}"));
        std::fs::write(&journal, "notes of somebody").unwrap();
        for told in [History::open(&path).err().unwrap(), History::read(&path).err().unwrap()] {
            assert!(told.message.contains("is a file of something else"), "{told}");
        }
        assert_eq!(std::fs::read_to_string(&journal).unwrap(), "notes of somebody");
        std::fs::remove_file(&journal).unwrap();
    }
    // SQLite would wait for a pipe, or remove it.
    #[cfg(unix)]
    for ending in ["-journal", "-wal"] {
        let pipe = folder.path().join(format!("plant.sqlite{ending}"));
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for told in [History::open(&path).err().unwrap(), History::read(&path).err().unwrap()] {
            assert!(told.message.contains("is a file of something else"), "{told}");
        }
        std::fs::remove_file(&pipe).unwrap();
    }
    // A journal that was just begun, and that of a writer that was killed.
    let journal = folder.path().join("plant.sqlite-journal");
    for begun in [vec![], vec![0; 512]] {
        std::fs::write(&journal, begun).unwrap();
        History::open(&path).unwrap();
    }
    std::fs::write(&path, "").unwrap();
    let mut writer = Connection::open(&path).unwrap();
    writer.execute_batch("PRAGMA cache_size = 1; CREATE TABLE before (x)").unwrap();
    let transaction = writer.transaction().unwrap();
    transaction.execute_batch("CREATE TABLE later (x)").unwrap();
    transaction.execute("INSERT INTO later VALUES (zeroblob(100000))", []).unwrap();
    let killed = folder.path().join("killed.sqlite");
    for (from, to) in [("plant.sqlite", "killed.sqlite"), ("plant.sqlite-journal", "killed.sqlite-journal")] {
        std::fs::copy(folder.path().join(from), folder.path().join(to)).unwrap();
    }
    drop(transaction);
    let told = History::open(&killed).err().unwrap();
    assert!(told.message.contains("a data base of something else"), "{told}");
}

/// Who opens a file while another program makes its tables sees none of them, or all.
#[test]
fn several_may_open_a_file_that_is_not_there() {
    let folder = tempfile::tempdir().unwrap();
    for file in 0..60 {
        let path = folder.path().join(format!("{file}.sqlite"));
        std::thread::scope(|scope| {
            for _ in 0..3 {
                scope.spawn(|| History::open(&path).unwrap());
            }
        });
    }
}
