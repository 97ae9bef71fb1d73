//! The exercise that a view or a watch follows.

use std::sync::Arc;

use tonic::Status;

use super::{ServedTerrain, Shared, leases::Hold, status::IntoStatus};
use crate::{exercise::Exercise, session::journal::Tape, store::Stored};

/// An exercise as it was last seen.
pub(super) struct Followed {
    name: String,
    stored: Stored,
}

impl Followed {
    /// The exercise called `name`; none when the name is empty.
    pub(super) async fn find<T: ServedTerrain>(shared: &Arc<Shared<T>>, name: &str) -> Result<Option<Self>, Status> {
        if name.is_empty() {
            return Ok(None);
        }
        let (inner, name) = (Arc::clone(shared), name.to_owned());
        shared.run(move || Self::get(&inner, &name)).await?
    }

    /// The same, for whoever may wait.
    pub(super) fn get<T>(shared: &Shared<T>, name: &str) -> Result<Option<Self>, Status> {
        if name.is_empty() {
            return Ok(None);
        }
        let stored = shared.store.get(name).map_err(IntoStatus::into_status)?;
        Ok(Some(Self { name: name.to_owned(), stored }))
    }

    /// As it was last seen.
    pub(super) fn exercise(&self) -> &Arc<Exercise> {
        &self.stored.exercise
    }

    /// Looks again; whether it has moved on, which is recorded for a view. An exercise that has ended ends who follows it.
    pub(super) async fn look<T: ServedTerrain>(
        &mut self,
        shared: &Arc<Shared<T>>,
        tape: &mut Option<Tape>,
    ) -> Result<bool, Status> {
        let (inner, name, last) = (Arc::clone(shared), self.name.clone(), self.stored.revision);
        let mut own = tape.take();
        let look = move || {
            let _order = inner.journal.as_ref().map(|journal| journal.order());
            let now = Self::get(&inner, &name);
            let has_moved = matches!(&now, Ok(Some(now)) if now.stored.revision != last);
            if let Some(own) = own.as_mut().filter(|_| has_moved) {
                own.follow();
            }
            (now, own)
        };
        let (now, own) = shared.run(look).await?;
        *tape = own;
        let now = match now {
            Err(status) if status.code() == tonic::Code::NotFound => None,
            found => found?.filter(|now| now.stored.created == self.stored.created),
        };
        let now = now.ok_or_else(|| self.ended(shared))?;
        let moved = now.stored.revision != self.stored.revision;
        *self = now;
        Ok(moved)
    }

    fn ended<T: ServedTerrain>(&self, shared: &Shared<T>) -> Status {
        let why = shared.leases.ended(self.stored.created).map(|owner| format!(": the lease of '{owner}' has run out"));
        Status::not_found(format!("exercise '{}' has ended{}", self.name, why.unwrap_or_default()))
    }

    /// Holds the lease of an owner in it; none when the name is empty.
    pub(super) fn hold<T: ServedTerrain>(&self, shared: &Shared<T>, owner: &str) -> Option<Hold> {
        (!owner.is_empty()).then(|| shared.leases.hold(self.stored.created, owner))
    }
}
