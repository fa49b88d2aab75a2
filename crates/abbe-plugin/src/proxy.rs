//! The traits of `abbe-core` for objects of the other side. Descriptions are checked once, results every time. So no plugin
//! can make the program panic or use values that are not finite.

mod estimator;
mod machine;
mod observed;
#[cfg(feature = "host")]
mod stage;
#[cfg(test)]
mod tests;

use std::any::Any;
use std::sync::Arc;

use abbe_core::{Error, Result, from_json};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::peer::{Answer, Peer, broken};
use crate::served::Served;

#[cfg(feature = "host")]
pub(crate) use estimator::Estimator;
pub(crate) use estimator::estimator;
pub(crate) use machine::machine;
pub(crate) use observed::observations;
#[cfg(feature = "host")]
pub(crate) use stage::Stage;

/// Asks a method whose answer is a text.
fn ask<Q: Serialize + ?Sized, A: DeserializeOwned>(
    peer: &dyn Peer,
    method: u32,
    question: &Q,
    objects: &[Arc<Served>],
) -> Result<A> {
    let answer = ask_whole(peer, method, question, objects)?;
    from_json(&answer.text).map_err(|error| broken(peer.who(), format!("gave an answer that cannot be read: {error}")))
}

fn ask_whole<Q: Serialize + ?Sized>(
    peer: &dyn Peer,
    method: u32,
    question: &Q,
    objects: &[Arc<Served>],
) -> Result<Answer> {
    let text = serde_json::to_string(question)
        .map_err(|error| Error::data(format!("what {} is asked cannot be written: {error}", peer.who())).fatal())?;
    let answer = peer.call(method, &text, objects);
    #[cfg(feature = "host")]
    crate::messages::heard(peer.who(), method, &text, &answer);
    answer.map_err(|failure| failure.error(peer.who()))
}

/// Refuses values that are not finite.
fn finite<'a>(peer: &dyn Peer, what: &str, values: impl IntoIterator<Item = &'a f64>) -> Result<()> {
    // No branch for each number.
    let is_broken = values.into_iter().fold(false, |broken, value| broken | !value.is_finite());
    match is_broken {
        false => Ok(()),
        true => Err(broken(peer.who(), format!("gave {what} that are not finite numbers"))),
    }
}

/// The object of the other side behind a proxy of a machine or of observations; none if the object is our own.
pub(crate) fn peer_of(proxy: &dyn Any) -> Option<Arc<dyn Peer>> {
    let machine = proxy.downcast_ref::<machine::Machine>().map(|machine| machine.peer.clone());
    machine.or_else(|| proxy.downcast_ref::<observed::Observed>().map(|observed| observed.peer.clone()))
}
