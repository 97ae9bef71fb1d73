//! Who calls, and what they may do: bearer tokens with roles.
//!
//! Without tokens everyone may do everything, and clients are told apart by their network address. With them each call
//! needs `authorization: Bearer SECRET`; health and the files of the viewer stay open. A token is compared in full, whatever
//! differs, so that the time tells nothing of it.

use std::{fmt, net::IpAddr, sync::Arc};

use serde::{Deserialize, Serialize};
use tonic::{Request, Status};

/// Least length of a token's secret in bytes.
pub const MIN_SECRET_BYTES: usize = 16;
/// Greatest number of tokens.
pub const MAX_TOKENS: usize = 1_000;

/// What a client may do.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Ask for terrain and lines of sight.
    Query,
    /// Open views, and read exercises.
    View,
    /// Make, change and end exercises.
    Direct,
    /// Everything, status and metrics included.
    Administer,
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Query => "query",
            Self::View => "view",
            Self::Direct => "direct",
            Self::Administer => "administer",
        })
    }
}

/// A secret and what its holder may do.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Token {
    /// Who holds it: in logs, metrics and limits.
    pub name: String,
    /// What the client sends; at least [`MIN_SECRET_BYTES`].
    pub secret: String,
    /// What it allows.
    pub roles: Vec<Role>,
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Token({:?}, {:?})", self.name, self.roles)
    }
}

/// The content of a token file.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tokens {
    /// All tokens.
    pub token: Vec<Token>,
}

impl Tokens {
    /// Says what makes no sense.
    pub fn check(&self) -> Result<(), String> {
        if self.token.is_empty() || self.token.len() > MAX_TOKENS {
            return Err(format!("it has {} tokens; 1 to {MAX_TOKENS} make sense", self.token.len()));
        }
        for (n, token) in self.token.iter().enumerate() {
            let earlier = &self.token[..n];
            if token.secret.len() < MIN_SECRET_BYTES || !token.secret.bytes().all(|b| b.is_ascii_graphic()) {
                return Err(format!(
                    "the secret of '{}' is not {MIN_SECRET_BYTES} or more ASCII characters",
                    token.name
                ));
            }
            if token.roles.is_empty() {
                return Err(format!("'{}' has no roles", token.name));
            }
            if earlier.iter().any(|other| other.name == token.name || other.secret == token.secret) {
                return Err(format!("'{}' shares its name or its secret with another token", token.name));
            }
        }
        Ok(())
    }

    fn holder(&self, secret: &str) -> Option<&Token> {
        // All are compared, each to its end.
        self.token.iter().fold(None, |found, token| {
            if is_same(token.secret.as_bytes(), secret.as_bytes()) { Some(token) } else { found }
        })
    }
}

fn is_same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |differing, (x, y)| differing | (x ^ y)) == 0
}

/// Who made a call.
#[derive(Clone, Debug)]
pub(super) struct Caller {
    /// The name of the token, or the network address.
    pub(super) name: Arc<str>,
}

impl Caller {
    /// Who was admitted.
    pub(super) fn of<R>(request: &Request<R>) -> Self {
        request.extensions().get::<Self>().cloned().unwrap_or_else(|| Self { name: Arc::from("unknown") })
    }

    /// Without a token.
    pub(super) fn by_address(address: Option<IpAddr>) -> Self {
        Self { name: address.map_or_else(|| "unknown".into(), |ip| ip.to_string().into()) }
    }
}

/// What must be allowed before a path is served.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Need {
    Nothing,
    /// Any token.
    Token,
    OneOf(&'static [Role]),
}

fn need(path: &str) -> Need {
    use Role::{Direct, Query, View};
    let mut parts = path.trim_start_matches('/').split('/');
    match (parts.next().unwrap_or_default(), parts.next().unwrap_or_default()) {
        ("grpc.health.v1.Health", _) => Need::Nothing,
        ("sightline.v1.TerrainService", "DescribeTerrain") => Need::Token,
        // Scene generators and directors put things on the ground.
        ("sightline.v1.TerrainService", _) => Need::OneOf(&[Query, View, Direct]),
        ("sightline.v1.LineOfSightService", _) => Need::OneOf(&[Query]),
        ("sightline.v1.SceneService", _) => Need::OneOf(&[View]),
        ("sightline.v1.ExerciseService", "ListExercises" | "GetExercise" | "WatchExercise") => {
            Need::OneOf(&[View, Direct])
        }
        ("sightline.v1.ExerciseService", _) => Need::OneOf(&[Direct]),
        (service, _) if service.starts_with("grpc.reflection.") => Need::Token,
        _ => Need::OneOf(&[]),
    }
}

/// Lets a caller in, or says why not. `authorization` is that header.
pub(super) fn admit(
    tokens: Option<&Tokens>,
    path: &str,
    authorization: Option<&str>,
    address: Option<IpAddr>,
) -> Result<Caller, Status> {
    let Some(tokens) = tokens else { return Ok(Caller::by_address(address)) };
    let need = need(path);
    if need == Need::Nothing {
        return Ok(Caller::by_address(address));
    }
    let secret = authorization.and_then(|value| {
        let (scheme, secret) = value.split_once(' ')?;
        scheme.eq_ignore_ascii_case("bearer").then_some(secret.trim())
    });
    let secret = secret.ok_or_else(|| {
        Status::unauthenticated("this server wants a token: send 'authorization: Bearer SECRET' with each call")
    })?;
    let token = tokens.holder(secret);
    let token = token.ok_or_else(|| Status::unauthenticated("the token is none that this server knows"))?;
    let allowed = match need {
        Need::Nothing | Need::Token => true,
        Need::OneOf(roles) => token.roles.iter().any(|role| *role == Role::Administer || roles.contains(role)),
    };
    if allowed {
        return Ok(Caller { name: token.name.as_str().into() });
    }
    let roles: Vec<_> = match need {
        Need::OneOf([]) => vec![Role::Administer.to_string()],
        Need::OneOf(roles) => roles.iter().map(Role::to_string).collect(),
        Need::Nothing | Need::Token => Vec::new(),
    };
    Err(Status::permission_denied(format!(
        "'{}' may not do this: it takes the role {}",
        token.name,
        roles.join(" or ")
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tokens() -> Tokens {
        let token = |name: &str, roles: &[Role]| Token {
            name: name.into(),
            secret: format!("{name}-{name}-0123456789"),
            roles: roles.to_vec(),
        };
        let all = [
            token("host", &[Role::Query, Role::Direct]),
            token("screen", &[Role::View]),
            token("chief", &[Role::Administer]),
        ];
        Tokens { token: all.to_vec() }
    }

    #[test]
    fn each_role_opens_its_calls_and_no_others() {
        let tokens = tokens();
        let ask = |who: &str, path: &str| {
            let header = format!("Bearer {who}-{who}-0123456789");
            admit(Some(&tokens), path, Some(&header), None).map(|caller| caller.name.to_string())
        };
        let cases = [
            ("/sightline.v1.TerrainService/DescribeTerrain", true, true),
            ("/sightline.v1.LineOfSightService/QueryRay", true, false),
            ("/sightline.v1.SceneService/StreamScene", false, true),
            ("/sightline.v1.ExerciseService/ListExercises", true, true),
            ("/sightline.v1.ExerciseService/ChangeExercise", true, false),
            ("/sightline.v1.ExerciseService/SomethingNew", true, false),
            ("/sightline.v1.OperationService/GetStatus", false, false),
            ("/metrics", false, false),
            ("/something/else", false, false),
            ("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", true, true),
        ];
        for (path, host, screen) in cases {
            for (who, expected) in [("host", host), ("screen", screen), ("chief", true)] {
                match ask(who, path) {
                    Ok(name) => assert!(expected && name == who, "{who} {path}"),
                    Err(status) => assert!(!expected && status.code() == tonic::Code::PermissionDenied, "{who} {path}"),
                }
            }
        }
    }

    #[test]
    fn what_is_no_token_is_unauthenticated_and_health_is_open() {
        let tokens = tokens();
        let path = "/sightline.v1.TerrainService/GetHeights";
        for bad in [None, Some("Bearer"), Some("Basic host-host-0123456789"), Some("Bearer host-host-012345678")] {
            let status = admit(Some(&tokens), path, bad, None).unwrap_err();
            assert_eq!(status.code(), tonic::Code::Unauthenticated, "{bad:?}");
        }
        assert!(admit(Some(&tokens), "/grpc.health.v1.Health/Check", None, None).is_ok());
        assert!(admit(None, path, None, None).is_ok());
    }

    #[test]
    fn token_files_that_are_unsafe_are_refused() {
        assert_eq!(tokens().check(), Ok(()));
        let mut short = tokens();
        short.token[1].secret = "short".into();
        let mut twice = tokens();
        twice.token[2].secret = twice.token[0].secret.clone();
        let mut idle = tokens();
        idle.token[0].roles.clear();
        for (bad, word) in [(short, "screen"), (twice, "shares"), (idle, "no roles"), (Tokens::default(), "0 tokens")] {
            assert!(bad.check().unwrap_err().contains(word), "{word}");
        }
        assert!(!format!("{:?}", tokens()).contains("0123456789"), "a log would tell the secret");
    }
}
