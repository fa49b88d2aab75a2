//! Histories on a PostgreSQL server: the same promises as in a file, on a real server that the test starts and ends.

#[cfg(feature = "postgres")]
mod keeps;
#[cfg(feature = "postgres")]
mod running;

#[cfg(not(feature = "postgres"))]
#[test]
fn histories_on_a_server() {
    crate::support::skipped("histories_on_a_server", "the tests are built without the feature `abbe-tests/postgres`");
}
