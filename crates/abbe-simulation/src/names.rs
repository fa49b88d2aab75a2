//! Names of a truth that the problem does not have. Valid names are left out, others are errors.

use abbe_core::{Error, Problem, Result, nearest};

/// Values of a truth that are not zero and have valid names, but that the problem does not have.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct NotSimulated {
    /// Parameters of the machine that the model does not have.
    pub machine: Vec<String>,
    /// Parameters of features that no artefact observes.
    pub artefacts: Vec<String>,
}

impl NotSimulated {
    /// Sorts names that the problem does not have. Fails for a name that looks misspelt or has no valid form.
    pub(crate) fn of<'a>(names: impl Iterator<Item = &'a String>, problem: &Problem) -> Result<Self> {
        let known = Known::of(problem);
        let mut left_out = Self::default();
        for name in names {
            if known.lacks_of_machine(name) {
                left_out.machine.push(name.clone());
            } else if known.lacks_of_artefact(name) {
                left_out.artefacts.push(name.clone());
            } else {
                return Err(known.wrong(name));
            }
        }
        Ok(left_out)
    }

    /// Warns of the values that are left out.
    pub(crate) fn warn(&self) {
        if !self.artefacts.is_empty() {
            let names = self.artefacts.join(", ");
            tracing::warn!("not in the recipe, left out: {names} (no artefact that is observed has them)");
        }
        if !self.machine.is_empty() {
            let names = self.machine.join(", ");
            tracing::warn!(
                "not in the recipe, left out: {names}. The model's `errors` do not list them: the simulated machine is \
                 not the one that the truth describes"
            );
        }
    }

    /// What is left out, as a line of the summary.
    pub(crate) fn summary(&self) -> Option<String> {
        let (machine, artefacts) = (self.machine.len(), self.artefacts.len());
        let is_empty = machine + artefacts == 0;
        (!is_empty).then(|| format!("left out: {machine} values of the machine and {artefacts} of artefacts"))
    }
}

/// The names that a problem has.
struct Known {
    machine: Vec<String>,
    /// Names of the unknowns and inputs of artefacts, each with its stage.
    own: Vec<(String, String)>,
}

impl Known {
    fn of(problem: &Problem) -> Self {
        let mut own = Vec::new();
        for set in &problem.sets {
            let inputs = set.info().inputs.iter().map(|input| &input.parameter);
            let parameters = set.info().unknowns.iter().chain(inputs);
            own.extend(parameters.map(|parameter| (set.name.clone(), parameter.name.clone())));
        }
        Self { machine: problem.model.info().parameters.iter().map(|parameter| parameter.name.clone()).collect(), own }
    }

    /// Whether it is the name of an error that this machine does not have.
    fn lacks_of_machine(&self, name: &str) -> bool {
        let Some((symbol, term)) = machine_error(name) else { return false };
        let listed = self.machine.iter().filter_map(|known| machine_error(known)).any(|(known, _)| known == symbol);
        // `EXX[l]` beside `EXX[1]` is a misspelling; `EXX[2]` is another error.
        !listed || term.is_some_and(is_common) || nearest(name, self.machine.iter().map(String::as_str)).is_none()
    }

    /// Whether it is the name of a parameter of a feature that is not observed.
    fn lacks_of_artefact(&self, name: &str) -> bool {
        let (stage, own) = match name.split_once('.').filter(|(stage, _)| !stage.contains('[')) {
            Some((stage, own)) => (Some(stage), own),
            None => (None, name),
        };
        let Some((kind, parameter)) = feature(own) else { return false };
        let stages = || self.own.iter().map(|(stage, _)| stage.as_str());
        let of_stage = |known: &str| stage.is_none_or(|stage| stage == known);
        if stage.is_some_and(|stage| !stages().any(of_stage) && nearest(stage, stages()).is_some()) {
            return false;
        }
        let own = self.own.iter().filter(|(stage, _)| of_stage(stage)).map(|(_, own)| own);
        // A machine may have parameters of this form, too: those of its styli.
        let known: Vec<(&str, &str)> = own.chain(&self.machine).filter_map(|known| feature(known)).collect();
        let mut of_kind = known.iter().filter(|(known, _)| *known == kind).peekable();
        match of_kind.peek() {
            Some(_) => of_kind.any(|(_, known)| *known == parameter),
            None => nearest(kind, known.iter().map(|(kind, _)| *kind)).is_none(),
        }
    }

    fn wrong(&self, name: &str) -> Error {
        let rule = "a name is that of an error of the machine (`EX0C`, `EXX[2]`), of its set-up (`dxt`), of a feature of \
                    an artefact (`facet[3].d`, also with its stage), or of a known input of an observed artefact";
        let full = self.own.iter().map(|(stage, own)| format!("{stage}.{own}")).filter(|_| name.contains('.'));
        let own = self.own.iter().map(|(_, own)| own.clone());
        let known: Vec<String> = self.machine.iter().cloned().chain(own).chain(full).collect();
        let help = match nearest(name, known.iter().map(String::as_str)) {
            Some(near) => format!("did you mean `{near}`? Else: {rule}"),
            None => rule.to_owned(),
        };
        Error::usage(format!("parameters.{name}: neither the machine nor an artefact has a `{name}`")).help(help)
    }
}

/// Symbol and term of an error of a machine: of location (`EX0C`) or of an axis (`EXX` and `2`) as ISO 230-1 has them,
/// or of the set-up (`dxt`). None if it is no such name.
fn machine_error(name: &str) -> Option<(&str, Option<&str>)> {
    let (symbol, term) = match name.split_once('[') {
        None => (name, None),
        Some((symbol, rest)) => {
            let (term, after) = rest.split_once(']').filter(|(term, _)| !term.is_empty() && !term.contains('['))?;
            (symbol, (after.is_empty() || after.strip_prefix('.').is_some_and(is_word)).then_some(Some(term))?)
        }
    };
    let mut letters = symbol.chars();
    match (letters.next()?, letters.next()?) {
        ('d', 'x' | 'y' | 'z') => matches!(letters.as_str(), "t" | "w"),
        ('E', 'X' | 'Y' | 'Z' | 'A' | 'B' | 'C') => {
            let axis = letters.as_str();
            let location = axis.strip_prefix('0');
            // The error of an axis is a function, of which a parameter is one term.
            (location.is_some() || term.is_some()) && is_axis(location.unwrap_or(axis))
        }
        _ => false,
    }
    .then_some((symbol, term))
}

/// Whether an axis may be called so: a letter, and a number if there are several.
fn is_axis(name: &str) -> bool {
    let number = name.strip_prefix(|c: char| "XYZUVWABCS".contains(c));
    number.is_some_and(|number| number.chars().all(|c| c.is_ascii_digit()))
}

/// Whether a term is a power, a reversal, or one of a polynomial in time (`t1`, `day2.t1`).
fn is_common(term: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_digit());
    let last = term.rsplit('.').next().unwrap_or(term);
    term == "b" || is_number(term) || last.strip_prefix('t').is_some_and(is_number)
}

/// Kind and parameter of a feature: `facet` and `d` of `facet[3].d`.
fn feature(name: &str) -> Option<(&str, &str)> {
    let (kind, rest) = name.split_once('[')?;
    let (label, parameter) = rest.split_once("].")?;
    (is_word(kind) && !label.is_empty() && !label.contains('[') && is_word(parameter)).then_some((kind, parameter))
}

fn is_word(text: &str) -> bool {
    let is_part = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || matches!(c, '_' | '-');
    text.starts_with(|c: char| c.is_ascii_lowercase()) && text.chars().all(is_part)
}

#[cfg(test)]
mod tests {
    use super::{Known, feature, machine_error};

    fn known() -> Known {
        let own = [("table", "facet[3].d"), ("table", "stylus_radius"), ("bar", "reference_error")];
        Known {
            machine: ["dxt", "EX0C", "EXX[1]", "EXX[b]", "dzt[t1]"].map(str::to_owned).to_vec(),
            own: own.map(|(stage, name)| (stage.to_owned(), name.to_owned())).to_vec(),
        }
    }

    #[test]
    fn names_have_a_form() {
        assert_eq!(machine_error("EX0C"), Some(("EX0C", None)));
        assert_eq!(machine_error("EXX[per0.635:1]"), Some(("EXX", Some("per0.635:1"))));
        assert_eq!(machine_error("EXX[per0.635].wavelength"), Some(("EXX", Some("per0.635"))));
        for wrong in
            ["", "E", "EXX", "EX0", "EX0D", "EXD[1]", "exx[1]", "EXX[]", "EXX[1", "EXX[1]x", "dxx", "facet[3].d"]
        {
            assert_eq!(machine_error(wrong), None, "{wrong}");
        }
        assert_eq!(feature("ball[top-1].x"), Some(("ball", "x")));
        for wrong in ["", "ball", "ball[1]", "ball[].x", "[1].x", "ball[1].", "EXX[1].x", "table.ball[1].x"] {
            assert_eq!(feature(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn what_is_right_but_not_there_is_told_from_what_is_misspelt() {
        let known = known();
        for name in ["EX0S", "EA0C", "EXX[2]", "EXX[spl0]", "EXY[2]", "EAB[3]", "dxw", "dzt[t2]", "EXX[t1]"] {
            assert!(known.lacks_of_machine(name), "{name}");
        }
        for name in ["facet[21].d", "table.facet[21].d", "ball[1].x", "spheres.ball[1].x", "stylus[2].x"] {
            assert!(!known.lacks_of_machine(name) && known.lacks_of_artefact(name), "{name}");
        }
        let slips = ["EXX[l]", "EXX[bb]", "EX0c", "EOXC", "dtx", "facet[3].dd", "facte[21].d", "tabel.facet[3].d"];
        for name in slips.into_iter().chain(["stylus_radus", "bar.reference_eror", "length[a-b]", "nonsense"]) {
            assert!(!known.lacks_of_machine(name) && !known.lacks_of_artefact(name), "{name}");
        }
        assert!(known.wrong("EXX[l]").to_string().contains("neither the machine nor an artefact has a `EXX[l]`"));
    }
}
