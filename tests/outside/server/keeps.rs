//! What a server keeps.

use abbe_history::{History, SCHEMA_VERSION};

use super::running::{PASSWORD, Running};
use crate::history::kept::{Plant, comes_back, kept_by_a_recipe, killed_writers, results};
use crate::history::serve::Served;
use crate::history::stored::{Site, comes_back_once, entry, readers_change_nothing, two_writers};
use crate::support::{Small, write};

/// Runs a law on a history in each data base of a new server.
fn on_a_server(test: &str, laws: &[fn(&Site<'_>)]) {
    let Some(server) = Running::start(test) else { return };
    for (law, name) in laws.iter().zip(["plant", "other"]) {
        let address = server.by_socket(name);
        let open = || History::on_server(&address).expect("it opens");
        let read = || History::read_server(&address).expect("it opens");
        law(&Site { open: &open, read: &read });
    }
}

fn plant(server: &Running) -> Plant {
    Plant { place: server.by_network("plant"), password: Some(PASSWORD.to_owned()) }
}

#[test]
fn a_server_gives_back_what_it_got_and_readers_change_nothing() {
    let test = "a_server_gives_back_what_it_got_and_readers_change_nothing";
    on_a_server(test, &[comes_back_once, readers_change_nothing]);
}

#[test]
fn two_writers_on_a_server_lose_and_double_nothing() {
    on_a_server("two_writers_on_a_server_lose_and_double_nothing", &[two_writers]);
}

#[test]
fn nothing_on_a_server_can_change() {
    let Some(server) = Running::start("nothing_on_a_server_can_change") else { return };
    let address = server.by_socket("plant");
    History::on_server(&address).and_then(|mut history| history.add(&entry(1))).expect("it is added");
    let mut raw = server.raw("plant");
    for (table, column) in [("entry", "recipe"), ("calibration", "machine")] {
        for statement in [
            format!("UPDATE abbe_history.{table} SET {column} = 'x'"),
            format!("DELETE FROM abbe_history.{table}"),
            format!("TRUNCATE abbe_history.{table} CASCADE"),
        ] {
            let refused = raw.batch_execute(&statement).expect_err(&statement);
            let said = refused.as_db_error().map_or_else(String::new, |error| error.message().to_owned());
            assert!(said.contains("never change"), "{statement}: {said}");
        }
    }
    assert_eq!(History::read_server(&address).and_then(|history| history.entry(1)).expect("an entry"), Some(entry(1)));
}

#[test]
fn versions_of_tables_on_a_server() {
    let Some(server) = Running::start("versions_of_tables_on_a_server") else { return };
    let address = server.by_socket("plant");
    let refused = |address: &str| {
        let error = History::read_server(address).err().expect("it is refused");
        error.message
    };
    assert!(refused(&address).contains("holds no history"));
    let mut history = History::on_server(&address).expect("it opens");
    history.add(&entry(1)).expect("it is added");
    // What the second version added is taken away: these are tables of the first.
    let mut raw = server.raw("plant");
    raw.batch_execute(
        "DROP INDEX abbe_history.calibration_of_machine; DELETE FROM abbe_history.version WHERE number > 1",
    )
    .expect("tables of the first version");
    let indices = "SELECT count(*) FROM pg_indexes WHERE indexname = 'calibration_of_machine'";
    let mut count = |text: &str| -> i64 { raw.query_one(text, &[]).expect("a number").get(0) };
    // A reader changes nothing; a writer brings it up to date and keeps what is there.
    assert_eq!(History::read_server(&address).and_then(|old| old.entries()).expect("entries").len(), 1);
    assert_eq!(count(indices), 0);
    let mut history = History::on_server(&address).expect("it is brought up to date");
    assert_eq!((count(indices), count("SELECT max(number) FROM abbe_history.version")), (1, SCHEMA_VERSION));
    history.add(&entry(2)).expect("it is added");
    assert_eq!(history.entry(1).expect("an entry"), Some(entry(1)));
    // A later version is refused, whoever asks.
    raw.execute("INSERT INTO abbe_history.version VALUES ($1)", &[&(SCHEMA_VERSION + 1)]).expect("a later version");
    for later in [History::on_server(&address), History::read_server(&address)] {
        let error = later.err().expect("it is refused");
        assert!(error.message.contains(&format!("version {}", SCHEMA_VERSION + 1)), "{error}");
    }
    // A schema of the same name that is something else stays as it is.
    let other = server.by_socket("other");
    server
        .raw("other")
        .batch_execute("CREATE SCHEMA abbe_history; CREATE TABLE abbe_history.x (y int)")
        .expect("a table");
    for error in [History::on_server(&other).err(), History::read_server(&other).err()] {
        assert!(error.expect("it is refused").message.contains("something else"));
    }
}

#[test]
fn commands_keep_results_on_a_server() {
    let Some(server) = Running::start("commands_keep_results_on_a_server") else { return };
    comes_back(&plant(&server));
    let other = Plant { place: server.by_network("other"), ..plant(&server) };
    kept_by_a_recipe(&other);
    // Its pages are those of a file.
    let small = Small::new();
    let served = Served::start(&small.path(""), &server.by_socket("plant"));
    assert!(served.page("/").contains("href=\"/entry/2\"") && served.page("/entry/2").contains("EX0C"));
    assert!(served.page("/entry/2/fine").contains("id=\"parameters\""));
}

#[test]
fn writers_to_a_server_that_are_killed_lose_and_double_nothing() {
    let Some(server) = Running::start("writers_to_a_server_that_are_killed_lose_and_double_nothing") else { return };
    killed_writers(&plant(&server));
}

/// Whatever is wrong with a server or its user is told without the password, and the password comes from where it should.
#[test]
fn no_message_about_a_server_has_the_password() {
    let Some(server) = Running::start("no_message_about_a_server_has_the_password") else { return };
    let small = Small::new();
    let all = results(&small, 2);
    let right = plant(&server);
    assert_eq!(right.abbe(&small, &["history", "add", &right.place, &all[0]]).status, 0);
    let wrong = "sehr falsch";
    let told = |place: &str, password: Option<&str>, expected: &str| {
        let plant = Plant { place: place.to_owned(), password: password.map(str::to_owned) };
        for arguments in
            [&["history", "list", place][..], &["history", "add", place, &all[0]], &["history", "check", place]]
        {
            let printed = plant.abbe(&small, arguments);
            let said = printed.stdout + &printed.stderr;
            assert!(printed.status == 1 || printed.status == 2, "{arguments:?}: {said}");
            assert!(said.contains(expected), "{arguments:?}: {said}");
            assert!(!said.contains(wrong) && !said.contains(PASSWORD), "{arguments:?}: {said}");
        }
    };
    told(&right.place, Some(wrong), "refuses this user");
    told(&right.place, None, "password");
    told(&right.place.replace("/plant", "/nowhere"), Some(PASSWORD), "no such data base");
    told("postgres://abbe@127.0.0.1:9/plant", Some(PASSWORD), "cannot be reached");
    told("postgres://abbe@plant.example/plant", Some(PASSWORD), "not encrypted");
    // A service file has it all; its text is in no message.
    let file = small.path("services");
    let port = right.place.rsplit(':').next().and_then(|rest| rest.split('/').next()).expect("a port");
    let service = |password: &str| {
        let text = format!("[plant]\nhost=127.0.0.1\nport={port}\ndbname=plant\nuser=abbe\npassword={password}\n");
        write(&file, &text);
        let plant = Plant { place: "postgres:///?service=plant".to_owned(), password: None };
        let mut listed = plant.program(&small, &["history", "list", &plant.place]);
        crate::support::printed(listed.env("PGSERVICEFILE", &file))
    };
    let listed = service(PASSWORD);
    assert!(listed.status == 0 && listed.stdout.contains("     1  "), "{}", listed.stderr);
    let refused = service(wrong);
    assert!(refused.status == 2 && !refused.stderr.contains(wrong), "{}", refused.stderr);
    // A user who may only read reads, and cannot add; who may insert adds.
    let user = |name: &str, rights: &str| {
        let statements = format!(
            "CREATE ROLE {name} LOGIN PASSWORD '{PASSWORD}'; GRANT USAGE ON SCHEMA abbe_history TO {name}; \
             GRANT {rights} ON ALL TABLES IN SCHEMA abbe_history TO {name}"
        );
        server.raw("plant").batch_execute(&statements).expect("a user");
    };
    user("reader", "SELECT");
    user("writer", "SELECT, INSERT");
    let reader = Plant { place: right.place.replace("abbe@", "reader@"), ..plant(&server) };
    assert_eq!(reader.abbe(&small, &["history", "list", &reader.place]).status, 0);
    let refused = reader.abbe(&small, &["history", "add", &reader.place, &all[1]]);
    assert!(refused.status == 2 && refused.stderr.contains("refuses it to this user"), "{}", refused.stderr);
    let writer = Plant { place: right.place.replace("abbe@", "writer@"), ..plant(&server) };
    let added = writer.abbe(&small, &["history", "add", &writer.place, &all[1]]);
    assert!(added.status == 0 && added.stdout.contains("entry 2"), "{}", added.stderr);
}
