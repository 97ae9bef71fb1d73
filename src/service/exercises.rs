//! Exercises: made, listed, read, changed and ended.

use std::sync::Arc;

use sightline_proto::v1::{self, exercise_service_server::ExerciseService};
use tonic::{Request, Response, Status};

use super::{ServedTerrain, Service, Shared, convert, limits::limited, status::IntoStatus};
use crate::{
    exercise::{Change, Exercise},
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
        let exercise = Exercise::new(&request.into_inner().name).map_err(IntoStatus::into_status)?;
        let shared = Arc::clone(&self.0);
        self.0.run(move || shared.store.create(exercise)).await?.map_err(IntoStatus::into_status)?;
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
        Ok(Response::new(v1::GetExerciseResponse {
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
        let _turn = self.0.changing.lock().await;
        let shared = Arc::clone(&self.0);
        let stored = self.0.run(move || changed(&shared, &name, &change)).await??;
        self.0.changes.send_modify(|n| *n += 1);
        Ok(Response::new(v1::ChangeExerciseResponse { epoch: stored.exercise.epoch() }))
    }

    async fn delete_exercise(
        &self,
        request: Request<v1::DeleteExerciseRequest>,
    ) -> Result<Response<v1::DeleteExerciseResponse>, Status> {
        let (shared, name) = (Arc::clone(&self.0), request.into_inner().name);
        let _turn = self.0.changing.lock().await;
        self.0.run(move || shared.store.delete(&name)).await?.map_err(IntoStatus::into_status)?;
        self.0.changes.send_modify(|n| *n += 1);
        Ok(Response::new(v1::DeleteExerciseResponse {}))
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
        match shared.store.replace(before.revision, after) {
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
