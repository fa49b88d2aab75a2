//! Values on a lattice of commands, linear between its nodes.

use abbe_core::{CommandCorrection, KinematicModel, StatusRole};

use crate::files::rounded;

/// Nodes along one axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Side {
    /// Name and unit of the axis: `X_mm`.
    pub label: String,
    /// Column of the status.
    pub column: usize,
    /// What of the file's unit one unit of memory is.
    pub factor: f64,
    /// Increasing, in the unit of the file. At least two.
    pub nodes: Vec<f64>,
}

impl Side {
    /// The node before a command, and the part of the way to the next one; the ends hold beyond them.
    fn place(&self, command: f64) -> (usize, f64) {
        let next = self.nodes.partition_point(|node| *node <= command).clamp(1, self.nodes.len() - 1);
        let (from, to) = (self.nodes[next - 1], self.nodes[next]);
        (next - 1, ((command - from) / (to - from)).clamp(0.0, 1.0))
    }
}

/// When a set of values is added to the commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// Always.
    Always,
    /// While an axis (its column of the direction) has made its last move in negative direction.
    Reversed(usize),
}

/// Values of all corrected axes at all nodes; the last side changes fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Set {
    pub name: String,
    pub when: When,
    /// Nodes x corrected axes, as in the file.
    pub values: Vec<Vec<f64>>,
}

/// An axis whose command is corrected.
#[derive(Debug, Clone, PartialEq)]
pub struct Corrected {
    pub label: String,
    pub column: usize,
    pub factor: f64,
}

/// Corrections over the workspace.
#[derive(Debug, Clone, PartialEq)]
pub struct Lattice {
    /// Columns of the status of the model.
    pub width: usize,
    pub sides: Vec<Side>,
    pub corrected: Vec<Corrected>,
    pub sets: Vec<Set>,
}

impl Lattice {
    /// Positions of all nodes, in the order of the values.
    pub fn nodes(&self) -> Vec<Vec<f64>> {
        let mut found = vec![Vec::new()];
        for side in &self.sides {
            let longer = |start: &Vec<f64>| {
                let start = start.clone();
                side.nodes.iter().map(move |node| [start.as_slice(), &[*node]].concat())
            };
            found = found.iter().flat_map(longer).collect();
        }
        found
    }

    /// Adds the values of another lattice, rounded to so many decimals. Fails unless it is linear between the nodes of this one.
    pub fn add(&mut self, other: &Self, decimals: i32) -> Result<(), String> {
        for axis in &other.corrected {
            if !self.corrected.iter().any(|own| own.label == axis.label) {
                return Err(format!("it corrects {}; `correct` has to have this axis, too", &axis.label[1..]));
            }
        }
        for side in &other.sides {
            let own = self.sides.iter().find(|own| own.label == side.label);
            let missing = side.nodes.iter().find(|node| own.is_none_or(|own| !own.nodes.contains(node)));
            if let Some(node) = missing {
                return Err(format!("it has a node at {} {node}; the new grid needs all of its nodes", side.label));
            }
        }
        let mut standing = vec![0.0; self.width];
        let nodes = self.nodes();
        for set in &other.sets {
            let place = self.sets.iter().position(|own| own.name == set.name).unwrap_or(self.sets.len());
            if place == self.sets.len() {
                let values = vec![vec![0.0; self.corrected.len()]; nodes.len()];
                self.sets.push(Set { name: set.name.clone(), when: set.when, values });
            }
            for (node, values) in nodes.iter().zip(&mut self.sets[place].values) {
                self.sides.iter().zip(node).for_each(|(side, at)| standing[side.column] = at / side.factor);
                let corners = other.corners(&standing);
                for (axis, value) in self.corrected.iter().zip(values) {
                    let Some(column) = other.corrected.iter().position(|added| added.label == axis.label) else {
                        continue;
                    };
                    let added: f64 = corners.iter().map(|(corner, weight)| set.values[*corner][column] * weight).sum();
                    *value = rounded(*value + added, decimals);
                }
            }
        }
        Ok(())
    }

    /// The corners around a status: index of the node and weight.
    fn corners(&self, status: &[f64]) -> Vec<(usize, f64)> {
        let mut corners = vec![(0, 1.0)];
        for side in &self.sides {
            let (first, part) = side.place(status[side.column] * side.factor);
            let of_side = |(index, weight): (usize, f64)| {
                let start = index * side.nodes.len() + first;
                [(start, weight * (1.0 - part)), (start + 1, weight * part)]
            };
            corners = corners.into_iter().flat_map(of_side).filter(|(_, weight)| *weight > 0.0).collect();
        }
        corners
    }
}

impl CommandCorrection for Lattice {
    fn commands(&self, programmed: &[f64]) -> abbe_core::Result<Vec<f64>> {
        let mut found = programmed.to_vec();
        for status in found.chunks_mut(self.width.max(1)) {
            let corners = self.corners(status);
            let acts = |set: &&Set| match set.when {
                When::Always => true,
                When::Reversed(column) => status[column] < 0.0,
            };
            let sets: Vec<&Set> = self.sets.iter().filter(acts).collect();
            for (place, axis) in self.corrected.iter().enumerate() {
                let of_set = |set: &&Set| -> f64 {
                    corners.iter().map(|(node, weight)| set.values[*node][place] * weight).sum()
                };
                status[axis.column] += sets.iter().map(of_set).sum::<f64>() / axis.factor;
            }
        }
        Ok(found)
    }
}

/// Columns of the directions of approach: names of the axes with them.
pub fn directions(model: &dyn KinematicModel) -> Vec<(String, usize)> {
    let columns = model.info().status.iter().enumerate();
    columns
        .filter_map(|(place, column)| match column.role {
            StatusRole::Direction(axis) => Some((model.info().axes.get(axis)?.name.clone(), place)),
            _ => None,
        })
        .collect()
}
