//! Failures of methods that have no result to tell them by.

use std::any::Any;
use std::sync::Arc;

use abbe_core::{Equations, ErrorFunction, PoseValues, Poses, Quantity, Variable};

use super::machine;
use crate::abi::{ABBE_DESCRIBE, ABBE_ERROR_TERMS};
use crate::peer::{Answer, Failure, Known, Peer, Transit};
use crate::served::Served;

const MACHINE: &str = r#"{ "axes": [], "parameters": [{ "name": "EXX[1]", "unit": "mm/mm" }], "settings": {},
    "status": [{ "name": "X", "quantity": "length", "absent": "refused" }] }"#;

/// A vendor that describes a machine, answers about its errors in this way, and fails in all else.
struct Vendor(&'static str);

impl Peer for Vendor {
    fn who(&self) -> &str {
        "the plugin `x`"
    }

    fn call(&self, method: u32, _: &str, _: &[Arc<Served>]) -> Result<Answer, Failure> {
        let text = match method {
            ABBE_DESCRIBE => MACHINE,
            ABBE_ERROR_TERMS if !self.0.is_empty() => self.0,
            _ => return Err(Failure::of(self.who(), "is broken")),
        };
        Ok(Answer { text: text.to_owned(), objects: Vec::new() })
    }

    fn poses(&self, _: &[f64], _: &[f64], _: &[Variable], _: &mut Poses) -> Result<(), Failure> {
        Ok(())
    }

    fn equations(&self, _: &[usize], _: PoseValues<'_>, _: Known<'_>, _: &mut Equations) -> Result<(), Failure> {
        Ok(())
    }

    fn as_any(&self) -> &dyn Any {
        self
    }
}

fn terms(answer: &'static str) -> (Vec<(usize, f64)>, Option<String>) {
    let Ok(machine) = machine(&Transit::Remote(Arc::new(Vendor(answer)))) else { panic!("the machine is in order") };
    let evaluate = || machine.evaluate(&[], &[0.0], &[], false, &mut Poses::default());
    assert_eq!(evaluate(), Ok(()));
    let function = ErrorFunction { symbol: "EXX".to_owned(), axis: 0, component: 0, quantity: Quantity::Length };
    let found = machine.error_terms(&function, &[0.0]);
    (found, evaluate().err().map(|error| error.message))
}

#[test]
fn terms_that_fail_are_no_numbers_and_the_next_evaluation_says_why() {
    assert_eq!(terms("[[0, 2.5]]"), (vec![(0, 2.5)], None));
    for (answer, expected) in [("", "is broken"), ("[[1, 2.5]]", "a term of no parameter"), ("{}", "cannot be read")] {
        let (found, said) = terms(answer);
        assert!(found.len() == 1 && found[0].1.is_nan(), "{answer}: {found:?}");
        let said = said.unwrap_or_default();
        assert!(said.contains(expected) && said.contains("the plugin `x`"), "{answer}: {said}");
    }
}
