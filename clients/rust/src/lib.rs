//! Rust client of a Sightline server: queries, exercises, scene streams, and pictures of what it sees.
//!
//! It depends on the wire types alone and trusts no one: a [`View`] checks the hash of each frame against its own
//! replica and asks for a snapshot when it does not fit; with `sightline_proto::verdict` it can check each sight line
//! on its own mesh.
//!
//! ```no_run
//! use sightline_client::{Client, Event, v1};
//!
//! # async fn fly() -> Result<(), sightline_client::ClientError> {
//! let client = Client::connect("http://127.0.0.1:7410").await?;
//! let settings = v1::ViewSettings {
//!     projection: Some(v1::view_settings::Projection::Perspective(v1::Perspective { tan_half_fov: 0.5, near_m: 1.0 })),
//!     viewport_width_px: 1280,
//!     viewport_height_px: 720,
//!     target: Some(v1::view_settings::Target::TriangleBudget(v1::TriangleBudget { triangles: 5_000 })),
//!     subscription: None, // all sight lines of the exercise
//!     regions: Vec::new(),
//! };
//! let pose = v1::Pose {
//!     eye: Some(v1::Position { x: 500.0, y: 400.0, z: 900.0 }),
//!     rotation: Some(v1::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }), // looking straight down
//! };
//! let mut view = client.open_view("training", settings, pose).await?;
//! while let Some(event) = view.next().await? {
//!     if let Event::Frame(frame) = event {
//!         println!("frame {} of {} triangles, hash {:016x}", frame.sequence, frame.triangle_count, frame.mesh_hash);
//!         view.steer(pose).await?;
//!     }
//! }
//! # Ok(())
//! # }
//! ```

mod access;
pub mod buffers;
mod exercises;
pub mod judge;
mod lines;
pub mod morph;
pub mod raster;
pub mod scene;
mod view;

use sightline_proto::v1::{
    exercise_service_client::ExerciseServiceClient, line_of_sight_service_client::LineOfSightServiceClient,
    operation_service_client::OperationServiceClient, scene_service_client::SceneServiceClient,
    terrain_service_client::TerrainServiceClient,
};
use thiserror::Error;
use tonic::{
    service::interceptor::InterceptedService,
    transport::{Channel, Endpoint},
};

use access::Bearer;

pub use access::Access;
pub use exercises::ExerciseWatch;
pub use lines::{LineStream, Tiles};
pub use sightline_proto::v1;
pub use view::{Event, View};

/// Greatest size of a message that a client accepts: a snapshot of millions of triangles fits.
pub const MAX_MESSAGE_BYTES: usize = 64 << 20;
/// Heights that are asked for in one call where many are wanted.
const SAMPLES_AT_ONCE: usize = 65_536;

/// Why a call failed.
#[derive(Debug, Error)]
pub enum ClientError {
    /// No connection.
    #[error("cannot connect to {address}: {reason}; is a Sightline server running there?")]
    Connect {
        /// The server's address.
        address: String,
        /// Why.
        reason: String,
    },
    /// The server refused.
    #[error("{:?}: {}", .0.code(), .0.message())]
    Refused(tonic::Status),
    /// Certificates do not fit: the server's, or this client's.
    #[error("{0}")]
    Certificate(String),
    /// The server said something that the protocol does not allow.
    #[error("the server broke the protocol: {0}")]
    Protocol(&'static str),
    /// What the server sent does not fit what it sent before.
    #[error("the scene stream does not fit together: {0}")]
    Scene(#[from] scene::SceneError),
    /// The stream is closed.
    #[error("the server has closed the view")]
    Closed,
}

/// The answers to a batch of lines, in its order.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct BatchAnswers {
    /// The verdicts.
    pub verdicts: Vec<v1::Verdict>,
    /// Whether each line grazes.
    pub grazes: Vec<bool>,
    /// Whether each verdict is exact.
    pub certain: Vec<bool>,
}

impl From<tonic::Status> for ClientError {
    fn from(status: tonic::Status) -> Self {
        access::explain(&status).map_or_else(|| Self::Refused(status), Self::Certificate)
    }
}

/// A connection to a server. Cheap to clone; clones share it.
#[derive(Clone, Debug)]
pub struct Client {
    channel: Channel,
    bearer: Bearer,
}

/// The channel, with the client's token added to each call.
type Secured = InterceptedService<Channel, Bearer>;

impl Client {
    /// Connects to `address`, for example `http://127.0.0.1:7410`; without a scheme, `http://` is meant.
    pub async fn connect(address: &str) -> Result<Self, ClientError> {
        Self::connect_with(address, &Access::default()).await
    }

    /// Connects to `address`, which begins with `https://` for TLS, with certificates and a token.
    pub async fn connect_with(address: &str, access: &Access) -> Result<Self, ClientError> {
        let failed = |error: &dyn std::error::Error| ClientError::Connect {
            address: address.to_owned(),
            reason: access::reason(error),
        };
        let uri = if address.contains("://") { address.to_owned() } else { format!("http://{address}") };
        let is_secured = uri.starts_with("https://");
        let mut endpoint = Endpoint::from_shared(uri).map_err(|error| failed(&error))?.tcp_nodelay(true);
        if is_secured {
            endpoint = endpoint.tls_config(access.tls()).map_err(|error| failed(&error))?;
        }
        let bearer = Bearer::new(access.token.as_deref())?;
        let channel = endpoint.connect().await.map_err(|error| failed(&error))?;
        Ok(Self { channel, bearer })
    }

    /// How the server is.
    pub async fn status(&self) -> Result<v1::GetStatusResponse, ClientError> {
        let mut operation = OperationServiceClient::new(self.secured());
        Ok(operation.get_status(v1::GetStatusRequest {}).await?.into_inner())
    }

    /// The terrain that the server holds.
    pub async fn terrain(&self) -> Result<v1::TerrainDescription, ClientError> {
        let response = self.terrains().describe_terrain(v1::DescribeTerrainRequest {}).await?;
        response.into_inner().terrain.ok_or(ClientError::Protocol("a terrain without a description"))
    }

    /// Surface heights at plan positions.
    pub async fn heights(&self, request: v1::GetHeightsRequest) -> Result<v1::GetHeightsResponse, ClientError> {
        Ok(self.terrains().get_heights(request).await?.into_inner())
    }

    /// Where the terrain has no data, for pictures of it; `None` where it has data everywhere.
    pub async fn voids(&self, terrain: &v1::TerrainDescription) -> Result<Option<raster::Voids>, ClientError> {
        if terrain.void_posts == 0 {
            return Ok(None);
        }
        let [columns, rows] = [terrain.nx, terrain.ny].map(raster::Voids::samples);
        let mut cells = Vec::with_capacity(columns.len() * rows.len());
        for some in rows.chunks((SAMPLES_AT_ONCE / columns.len().max(1)).max(1)) {
            let places = some.iter().flat_map(|&j| columns.iter().map(move |&i| (f64::from(i), f64::from(j))));
            let (x, y): (Vec<_>, Vec<_>) = places.unzip();
            let asked = x.len();
            let frame = v1::CoordinateFrame::Grid.into();
            let known = self.heights(v1::GetHeightsRequest { frame, x, y, ..Default::default() }).await?.known;
            if known.len() != asked {
                return Err(ClientError::Protocol("another number of heights than was asked for"));
            }
            cells.extend(known.into_iter().map(|known| !known));
        }
        Ok(raster::Voids::new(columns.len(), rows.len(), cells))
    }

    /// The exact answer to one line.
    pub async fn query(
        &self,
        request: v1::QueryLineOfSightRequest,
    ) -> Result<v1::QueryLineOfSightResponse, ClientError> {
        Ok(self.lines().query_line_of_sight(request).await?.into_inner())
    }

    /// The exact answers to many lines.
    pub async fn query_batch(&self, request: v1::QueryLineOfSightBatchRequest) -> Result<BatchAnswers, ClientError> {
        let mut chunks = self.lines().query_line_of_sight_batch(request).await?.into_inner();
        let mut answers = BatchAnswers::default();
        while let Some(chunk) = chunks.message().await? {
            let lengths = [chunk.grazes.len(), chunk.certain.len()];
            if chunk.first_index as usize != answers.verdicts.len() || lengths != [chunk.verdicts.len(); 2] {
                return Err(ClientError::Protocol("a chunk of answers that does not follow the one before"));
            }
            answers.verdicts.extend(chunk.verdicts());
            answers.grazes.extend(&chunk.grazes);
            answers.certain.extend(&chunk.certain);
        }
        Ok(answers)
    }

    /// Makes an exercise.
    pub async fn create_exercise(&self, name: &str) -> Result<(), ClientError> {
        self.exercises().create_exercise(v1::CreateExerciseRequest { name: name.to_owned(), lease: None }).await?;
        Ok(())
    }

    /// The outlines of all exercises, by name.
    pub async fn list_exercises(&self) -> Result<Vec<v1::ExerciseSummary>, ClientError> {
        Ok(self.exercises().list_exercises(v1::ListExercisesRequest {}).await?.into_inner().exercises)
    }

    /// An exercise at its present epoch.
    pub async fn exercise(&self, name: &str) -> Result<v1::GetExerciseResponse, ClientError> {
        let request = v1::GetExerciseRequest { name: name.to_owned() };
        Ok(self.exercises().get_exercise(request).await?.into_inner())
    }

    /// Changes an exercise; returns the epoch that this made.
    pub async fn change_exercise(&self, change: v1::ChangeExerciseRequest) -> Result<u64, ClientError> {
        Ok(self.exercises().change_exercise(change).await?.into_inner().epoch)
    }

    /// Ends an exercise and every view of it.
    pub async fn delete_exercise(&self, name: &str) -> Result<(), ClientError> {
        self.exercises().delete_exercise(v1::DeleteExerciseRequest { name: name.to_owned() }).await?;
        Ok(())
    }

    /// Opens a view of `exercise` (empty for none) with its first pose.
    pub async fn open_view(
        &self,
        exercise: &str,
        settings: v1::ViewSettings,
        pose: v1::Pose,
    ) -> Result<View, ClientError> {
        let (settings, pose) = (Some(settings), Some(pose));
        self.open(v1::OpenView { exercise: exercise.to_owned(), settings, pose, ..Default::default() }).await
    }

    /// Opens a view with all that may be said of it: its pace, and the lease that it holds.
    pub async fn open(&self, open: v1::OpenView) -> Result<View, ClientError> {
        let scenes = SceneServiceClient::new(self.secured()).max_decoding_message_size(MAX_MESSAGE_BYTES);
        View::open(scenes, open).await
    }

    fn secured(&self) -> Secured {
        InterceptedService::new(self.channel.clone(), self.bearer.clone())
    }

    fn terrains(&self) -> TerrainServiceClient<Secured> {
        TerrainServiceClient::new(self.secured()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    fn lines(&self) -> LineOfSightServiceClient<Secured> {
        LineOfSightServiceClient::new(self.secured()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    fn exercises(&self) -> ExerciseServiceClient<Secured> {
        ExerciseServiceClient::new(self.secured()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }
}
