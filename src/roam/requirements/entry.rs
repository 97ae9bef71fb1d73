//! A line with what is known of it on the mesh as it stands.

use std::ops::ControlFlow;

use sightline_proto::{
    diamond::{Post, Triangle},
    mesh::Mesh,
    verdict::{for_each_triangle_above, passes_below},
};

use super::{
    RequiredLine,
    ground::Ground,
    rule::Rule,
    stable::steadiest,
    witness::{Witness, find},
};
use crate::{
    roam::{Terrain, queues::DualQueue},
    terrain::ReadError,
};

/// Whether a line is given what it needs.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Standing {
    /// It is, whenever it does not hold.
    Served,
    /// There was no room for it. It is served again in its turn, or once there may be.
    Dropped,
    /// No split makes a difference: its ends are no numbers.
    Hopeless,
}

/// A line with its place in the procedure.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) line: RequiredLine,
    pub(super) rule: Rule,
    /// Whether it holds on the mesh, as of the last check.
    pub(super) holds: bool,
    /// Whether its ends or what it asks changed since the last check.
    pub(super) is_new: bool,
    /// Whether what it owns was chosen in this update.
    pub(super) is_fresh: bool,
    pub(super) standing: Standing,
    /// Triangles that it lacked when it was last dropped.
    pub(super) lacked: u64,
    /// Posts that it requires, without their ancestors.
    pub(super) own: Vec<Post>,
    /// Of a blocked line that holds: a triangle of the mesh above it.
    cover: Option<Triangle>,
    /// Places where a blocked line may be blocked; while its ends are the same.
    pub(super) witnesses: Option<Vec<Witness>>,
    /// The one that its stable set stands on.
    pub(super) steadiest: Option<Witness>,
}

impl Entry {
    pub(super) fn new(line: RequiredLine, rule: Rule) -> Self {
        Self {
            line,
            rule,
            holds: false,
            is_new: true,
            is_fresh: true,
            standing: Standing::Served,
            lacked: 0,
            own: Vec::new(),
            cover: None,
            witnesses: None,
            steadiest: None,
        }
    }

    /// Takes another line in the place of this one. Whether what it owns may go on serving; otherwise it starts afresh.
    pub(super) fn replace(&mut self, line: RequiredLine, rule: Rule) -> bool {
        let is_alike = std::mem::discriminant(&self.rule) == std::mem::discriminant(&rule);
        (self.line, self.rule, self.is_new) = (line, rule, true);
        (self.witnesses, self.steadiest) = (None, None);
        if !is_alike || self.standing == Standing::Hopeless {
            self.standing = Standing::Served;
        }
        is_alike
    }

    /// Finds the place that its stable set stands on, for a line that has one.
    pub(super) fn find_steadiest<T: Terrain>(&mut self, ground: &Ground<'_, T>) -> Result<(), ReadError> {
        if self.steadiest.is_none() && matches!(self.rule, Rule::Blocked | Rule::Obstruction(_)) {
            let known = find(ground, &self.line, &mut self.witnesses)?;
            self.steadiest = steadiest(ground, &self.line, &known)?;
        }
        Ok(())
    }

    /// Whether it is dropped and does not hold.
    pub(super) fn is_short(&self) -> bool {
        self.standing == Standing::Dropped && !self.holds
    }

    /// Checks the line on the whole mesh, or on as little of it as proves the same.
    pub(super) fn check<T: Terrain>(&mut self, mesh: &DualQueue<T>) -> Result<(), ReadError> {
        self.is_new = false;
        self.holds = match self.rule {
            Rule::Blocked => {
                self.cover = self.cover.filter(|triangle| covers(mesh, triangle, &self.line));
                self.cover.is_some() || self.cover_now(mesh)
            }
            _ => self.rule.holds(mesh, &self.line)?,
        };
        Ok(())
    }

    /// Checks a line that is not new after the diamonds at `changed`, which it may touch, were split or merged, and
    /// nothing else near it.
    pub(super) fn check_near<T: Terrain>(&mut self, mesh: &DualQueue<T>, changed: &[Post]) -> Result<(), ReadError> {
        match self.rule {
            Rule::Clear if self.holds => {
                let is_new_above = |&p: &Post| {
                    let parts = mesh.root().triangles(p).filter(|t| mesh.height_of(t.apex).is_some());
                    parts.into_iter().any(|t| {
                        for_each_triangle_above(mesh, &[t], [self.line.a, self.line.b], |_| ControlFlow::Break(()))
                            .is_break()
                    })
                };
                self.holds = !changed.iter().any(is_new_above);
                Ok(())
            }
            // While the triangle above it is there, and it is where it was, nothing else counts.
            Rule::Blocked if self.holds && self.cover.is_some_and(|t| mesh.has(&t)) => Ok(()),
            _ => self.check(mesh),
        }
    }

    /// Looks for a triangle above the line.
    fn cover_now<T: Terrain>(&mut self, mesh: &DualQueue<T>) -> bool {
        let _ = for_each_triangle_above(mesh, &mesh.root().roots(), [self.line.a, self.line.b], |triangle| {
            self.cover = Some(triangle);
            ControlFlow::Break(())
        });
        self.cover.is_some()
    }
}

/// Whether a triangle is one of the mesh and above the line somewhere.
fn covers<T: Terrain>(mesh: &DualQueue<T>, triangle: &Triangle, line: &RequiredLine) -> bool {
    mesh.has(triangle) && passes_below(line.a, line.b, mesh.corners_in_space(triangle), mesh.grid_posts())
}
