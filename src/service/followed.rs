//! The exercise that a view or a watch follows.

use std::sync::Arc;

use tonic::Status;

use super::{ServedTerrain, Shared, leases::Hold, status::IntoStatus};
use crate::{exercise::Exercise, store::Stored};

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
        let (inner, key) = (Arc::clone(shared), name.to_owned());
        let stored = shared.run(move || inner.store.get(&key)).await?.map_err(IntoStatus::into_status)?;
        Ok(Some(Self { name: name.to_owned(), stored }))
    }

    /// As it was last seen.
    pub(super) fn exercise(&self) -> &Arc<Exercise> {
        &self.stored.exercise
    }

    /// Looks again; whether it has moved on. An exercise that has ended ends who follows it.
    pub(super) async fn look<T: ServedTerrain>(&mut self, shared: &Arc<Shared<T>>) -> Result<bool, Status> {
        let now = match Self::find(shared, &self.name).await {
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
