//! Exercises: made, listed, read, changed, watched and ended; their leases renewed.

use std::sync::Arc;

use sightline_proto::v1::{self, exercise_service_server::ExerciseService};
use tonic::{Request, Response, Status};

use super::{ServedTerrain, Service, Shared, access::Caller, convert, limits::limited, status::IntoStatus, verdicts};
use crate::{
    exercise::{Change, Exercise, Lease},
    session::journal::Entry,
    store::{StoreError, Stored},
};

/// How often a change is tried again when another server of the same store was faster.
const MAX_TRIES: usize = 5;

#[tonic::async_trait]
impl<T: ServedTerrain> ExerciseService for Service<T> {
    async fn create_exercise(
        &self,
        request: Request<v1::CreateExerciseRequest>,
    ) -> Result<Response<v1::CreateExerciseResponse>, Status> {
        let v1::CreateExerciseRequest { name, lease } = request.into_inner();
        let mut exercise = Exercise::new(&name).map_err(IntoStatus::into_status)?;
        let lease = convert::lease(lease)?;
        if let Some(lease) = &lease {
            exercise = exercise.under(lease);
        }
        let _turn = self.0.changing.lock().await;
        let shared = Arc::clone(&self.0);
        let create = move || {
            let name = exercise.name().to_owned();
            shared.written(shared.keep(|| Entry::Created { name }, || shared.store.create(exercise)))
        };
        let stored = self.0.run(create).await?;
        self.renew(stored.map_err(IntoStatus::into_status)?.created, lease.as_ref());
        Ok(Response::new(v1::CreateExerciseResponse {}))
    }

    async fn list_exercises(
        &self,
        _: Request<v1::ListExercisesRequest>,
    ) -> Result<Response<v1::ListExercisesResponse>, Status> {
        let shared = Arc::clone(&self.0);
        let stored = self.0.run(move || shared.store.list()).await?.map_err(IntoStatus::into_status)?;
        let exercises = stored.iter().map(summary).collect();
        Ok(Response::new(v1::ListExercisesResponse { exercises }))
    }

    async fn get_exercise(
        &self,
        request: Request<v1::GetExerciseRequest>,
    ) -> Result<Response<v1::GetExerciseResponse>, Status> {
        let (shared, name) = (Arc::clone(&self.0), request.into_inner().name);
        let stored = self.0.run(move || shared.store.get(&name)).await?.map_err(IntoStatus::into_status)?;
        let leases = stored.exercise.leases().map(|(_, granted)| {
            let (left, streams) = self.0.leases.state(stored.created, granted.lease.owner());
            convert::lease_to_wire(granted, left, streams)
        });
        Ok(Response::new(v1::GetExerciseResponse {
            leases: leases.collect(),
            epoch: stored.exercise.epoch(),
            entities: stored.exercise.entities().map(convert::entity_to_wire).collect(),
            sight_lines: stored.exercise.sight_lines().map(convert::line_to_wire).collect(),
        }))
    }

    async fn change_exercise(
        &self,
        request: Request<v1::ChangeExerciseRequest>,
    ) -> Result<Response<v1::ChangeExerciseResponse>, Status> {
        let request = request.into_inner();
        let (change, name) = (convert::change(&request)?, request.name);
        let lease = change.lease.clone();
        let _turn = self.0.changing.lock().await;
        let shared = Arc::clone(&self.0);
        let stored = self.0.run(move || changed(&shared, &name, &change)).await??;
        self.renew(stored.created, lease.as_ref());
        self.0.changes.send_modify(|n| *n += 1);
        Ok(Response::new(v1::ChangeExerciseResponse { epoch: stored.exercise.epoch() }))
    }

    async fn delete_exercise(
        &self,
        request: Request<v1::DeleteExerciseRequest>,
    ) -> Result<Response<v1::DeleteExerciseResponse>, Status> {
        let (shared, name) = (Arc::clone(&self.0), request.into_inner().name);
        let _turn = self.0.changing.lock().await;
        let delete = move || {
            shared.written(shared.keep(|| Entry::Deleted { name: name.clone() }, || shared.store.delete(&name)))
        };
        self.0.run(delete).await?.map_err(IntoStatus::into_status)?;
        self.0.changes.send_modify(|n| *n += 1);
        Ok(Response::new(v1::DeleteExerciseResponse {}))
    }

    type WatchExerciseStream = verdicts::Stream;

    async fn watch_exercise(
        &self,
        request: Request<v1::WatchExerciseRequest>,
    ) -> Result<Response<Self::WatchExerciseStream>, Status> {
        let caller = Caller::of(&request);
        verdicts::begin(&self.0, &caller, request.into_inner()).await.map(Response::new)
    }

    async fn renew_lease(
        &self,
        request: Request<v1::RenewLeaseRequest>,
    ) -> Result<Response<v1::RenewLeaseResponse>, Status> {
        let v1::RenewLeaseRequest { name, owner } = request.into_inner();
        // Nothing runs out between the answer and what it promises.
        let _turn = self.0.changing.lock().await;
        let shared = Arc::clone(&self.0);
        let stored = self.0.run(move || shared.store.get(&name)).await?.map_err(IntoStatus::into_status)?;
        let granted = stored.exercise.lease(&owner).ok_or_else(|| {
            let name = stored.exercise.name();
            Status::not_found(format!("in exercise '{name}' nothing is under a lease of '{owner}', or no more"))
        })?;
        self.renew(stored.created, Some(&granted.lease));
        Ok(Response::new(v1::RenewLeaseResponse { term_s: granted.lease.term_s() }))
    }
}

impl<T> Service<T> {
    /// Begins the term of a lease that was given.
    fn renew(&self, created: u64, lease: Option<&Lease>) {
        if let Some(lease) = lease {
            self.0.leases.renew(created, lease.owner(), lease.term_s());
        }
    }
}

fn changed<T: ServedTerrain>(shared: &Shared<T>, name: &str, change: &Change) -> Result<Stored, Status> {
    for _ in 0..MAX_TRIES {
        let before = shared.store.get(name).map_err(IntoStatus::into_status)?;
        let after = before.exercise.changed(change, &shared.site, &*shared.terrain);
        let after = after.map_err(IntoStatus::into_status)?;
        let (things, limit) = (after.entities().len() + after.sight_lines().len(), shared.limits.things_per_exercise);
        if things > limit {
            return Err(limited("things_per_exercise", "entities and sight lines", things as u64, limit as u64));
        }
        let what = || Entry::Changed { name: name.to_owned(), change: change.clone() };
        match shared.written(shared.keep(what, || shared.store.replace(before.revision, after))) {
            Err(StoreError::Conflict(_)) => {}
            result => return result.map_err(IntoStatus::into_status),
        }
    }
    Err(StoreError::Conflict(name.to_owned()).into_status())
}

fn summary(stored: &Stored) -> v1::ExerciseSummary {
    let exercise = &stored.exercise;
    v1::ExerciseSummary {
        name: exercise.name().to_owned(),
        epoch: exercise.epoch(),
        entities: exercise.entities().len() as u32,
        sight_lines: exercise.sight_lines().len() as u32,
    }
}
