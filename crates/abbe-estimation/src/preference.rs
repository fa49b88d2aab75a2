//! Which of several unknowns that do the same is rather estimated.
//!
//! The order is: what is preferred by name; offsets of tool and workpiece, which are different in every set-up; location errors;
//! motion errors; unknowns of artefacts; location errors that are zero by convention, because they say where the machine's own frame is
//! (ISO 230-1: zero positions of axes, both orientations of the primary linear axis, that of the secondary one about the primary);
//! turns of tool and workpiece. On the machine of Viprey et al. (2019) this gives their Table 1.

use abbe_core::{AxisKind, Error, KinematicModel, Owner, PathItem, Problem, Result, Unknown, matches};

/// Refuses a name or pattern that matches no unknown, with its index in the setting `prefer`.
pub fn check_preferences(problem: &Problem, prefer: &[String]) -> Result<()> {
    for (index, pattern) in prefer.iter().enumerate() {
        if !problem.unknowns.iter().any(|unknown| matches(pattern, &unknown.name)) {
            let names = problem.unknowns.iter().map(|unknown| unknown.name.as_str());
            let mut error = Error::usage(format!("`{pattern}` matches nothing that is to be estimated"));
            error = error.suggest(pattern, names);
            error.setting = vec![PathItem::Key("prefer".to_owned()), PathItem::Index(index)];
            return Err(error);
        }
    }
    Ok(())
}

/// The unknowns of a problem by their indices, those first that are rather estimated than others.
///
/// `prefer` has names and patterns, the most preferred first; one that matches nothing prefers nothing.
pub fn in_order_of_preference(problem: &Problem, prefer: &[String]) -> Vec<usize> {
    let convention = Convention::of(problem.model.as_ref());
    let rank = |&index: &usize| {
        let unknown = &problem.unknowns[index];
        let preferred = prefer.iter().position(|pattern| matches(pattern, &unknown.name));
        (preferred.unwrap_or(usize::MAX), convention.rank(unknown))
    };
    let mut order: Vec<usize> = (0..problem.unknowns.len()).collect();
    order.sort_by_key(rank);
    order
}

/// What is zero by convention on a machine.
pub(crate) struct Convention {
    zero: Vec<String>,
}

impl Convention {
    /// Letters of the components of location errors about and along x, y, z.
    const ALONG: [char; 3] = ['X', 'Y', 'Z'];
    const ABOUT: [char; 3] = ['A', 'B', 'C'];

    pub(crate) fn of(model: &dyn KinematicModel) -> Self {
        // The direction among x, y, z that an axis is closest to.
        let main = |direction: &[f64; 3]| {
            (0..3).max_by(|&a, &b| direction[a].abs().total_cmp(&direction[b].abs())).unwrap_or_default()
        };
        let mut zero = Vec::new();
        // The primary and the secondary linear axis: the first two directions of x, y, z that the machine has.
        let mut linear: Vec<(usize, &str)> = Vec::new();
        for axis in &model.info().axes {
            let (name, direction) = (axis.name.as_str(), main(&axis.direction));
            match axis.kind {
                AxisKind::Linear => {
                    zero.push(format!("E{}0{name}", Self::ALONG[direction]));
                    linear.push((direction, name));
                }
                AxisKind::Rotary => zero.push(format!("E{}0{name}", Self::ABOUT[direction])),
            }
        }
        linear.sort_by_key(|(direction, _)| *direction);
        if let Some((primary, name)) = linear.first() {
            zero.extend(Self::ABOUT.iter().map(|about| format!("E{about}0{name}")));
            if let Some((_, name)) = linear.iter().find(|(direction, _)| direction != primary) {
                zero.push(format!("E{}0{name}", Self::ABOUT[*primary]));
            }
        }
        Self { zero }
    }

    /// Whether a location error is zero by convention.
    pub(crate) fn is_zero(&self, name: &str) -> bool {
        self.zero.iter().any(|zero| zero == name)
    }

    /// The place of an unknown in the order of preference, the smaller the better.
    fn rank(&self, unknown: &Unknown) -> usize {
        let name = unknown.name.as_str();
        let set_up = |pattern| matches(pattern, name);
        match unknown.owner {
            Owner::Machine if ["dxt", "dyt", "dzt", "dxw", "dyw", "dzw"].contains(&name) => 0,
            Owner::Machine if ["da?", "db?", "dc?"].into_iter().any(set_up) => 5,
            Owner::Machine if self.is_zero(name) => 4,
            Owner::Machine if matches("E?0*", name) => 1,
            Owner::Machine | Owner::Tie => 2,
            Owner::Set(_) | Owner::Input => 3,
        }
    }
}
