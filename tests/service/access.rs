//! Certificates and tokens, as clients meet them.

use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair, date_time_ymd};
use sightline::service::{Role, Tls, Token, Tokens};
use sightline_client::Access;

use super::*;

/// An authority that signs certificates.
struct Authority(CertifiedIssuer<'static, KeyPair>);

impl Authority {
    fn new(name: &str) -> Self {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        Self(CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap())
    }

    fn pem(&self) -> Vec<u8> {
        self.0.pem().into_bytes()
    }

    /// A certificate and its key, good until the year.
    fn issue(&self, year: i32) -> (Vec<u8>, Vec<u8>) {
        let mut params = CertificateParams::new(vec!["127.0.0.1".to_owned(), "localhost".to_owned()]).unwrap();
        params.not_before = date_time_ymd(2001, 1, 1);
        params.not_after = date_time_ymd(year, 1, 1);
        let key = KeyPair::generate().unwrap();
        let certificate = params.signed_by(&key, &self.0).unwrap();
        (certificate.pem().into_bytes(), key.serialize_pem().into_bytes())
    }
}

const LATER: i32 = 4000;
const LONG_AGO: i32 = 2010;

async fn secured(authority: &Authority, year: i32, is_mutual: bool) -> Running {
    let (certificate, key) = authority.issue(year);
    let tls = Tls { certificate, key, client_authorities: is_mutual.then(|| authority.pem()) };
    Running::start_with(TestTerrain::new(None), ServeOptions { tls: Some(tls), ..ServeOptions::default() }).await
}

/// What a call says to a client with this access.
async fn words(running: &Running, access: &Access) -> Result<u32, String> {
    let call = async {
        let client = Client::connect_with(&format!("https://{}", running.address), access).await?;
        Ok::<_, ClientError>(client.terrain().await?.nx)
    };
    timeout(PATIENCE, call).await.expect("an answer in time").map_err(|error| error.to_string())
}

#[tokio::test]
async fn certificates_let_in_or_say_why_not() {
    let (ours, theirs) = (Authority::new("ours"), Authority::new("theirs"));
    let trusting = Access { authorities: Some(ours.pem()), ..Access::default() };
    let plain = secured(&ours, LATER, false).await;
    assert_eq!(words(&plain, &trusting).await, Ok(90));
    let stranger = Access { authorities: Some(theirs.pem()), ..Access::default() };
    let found = words(&plain, &stranger).await.unwrap_err();
    assert!(found.contains("no authority that this client was given"), "{found}");
    let expired = secured(&ours, LONG_AGO, false).await;
    let found = words(&expired, &trusting).await.unwrap_err();
    assert!(found.contains("expired"), "{found}");

    let mutual = secured(&ours, LATER, true).await;
    let with = |authority: &Authority, year| Access { identity: Some(authority.issue(year)), ..trusting.clone() };
    assert_eq!(words(&mutual, &with(&ours, LATER)).await, Ok(90));
    for access in [trusting.clone(), with(&ours, LONG_AGO), with(&theirs, LATER)] {
        words(&mutual, &access).await.unwrap_err();
    }
}

#[tokio::test]
async fn tokens_open_what_their_roles_allow() {
    let token = |name: &str, roles: &[Role]| Token {
        name: name.into(),
        secret: format!("{name}-secret-of-some-length"),
        roles: roles.to_vec(),
    };
    let tokens = Tokens { token: vec![token("host", &[Role::Query]), token("chief", &[Role::Administer])] };
    let limits = Limits { views_per_client: 1, ..Limits::default() };
    let options = ServeOptions { tokens: Some(tokens), limits, ..ServeOptions::default() };
    let running = Running::start_with(TestTerrain::new(None), options).await;
    let client = async |name: Option<&str>| {
        let token = name.map(|name| format!("{name}-secret-of-some-length"));
        Client::connect_with(&running.address, &Access { token, ..Access::default() }).await.unwrap()
    };
    refusal(client(None).await.terrain().await, Code::Unauthenticated, "token");
    refusal(client(Some("someone")).await.terrain().await, Code::Unauthenticated, "none that this server knows");
    let host = client(Some("host")).await;
    let line = v1::QueryLineOfSightRequest { a: end(1.0, 1.0, 1.0), b: end(9.0, 9.0, 1.0), ..Default::default() };
    host.query(line).await.unwrap();
    refusal(host.create_exercise("one").await, Code::PermissionDenied, "direct");
    refusal(host.status().await, Code::PermissionDenied, "administer");
    refusal(host.open_view("", settings(100), pose(1.0, 1.0)).await, Code::PermissionDenied, "view");
    let chief = client(Some("chief")).await;
    chief.create_exercise("one").await.unwrap();
    // The client is the token, not the connection.
    let mut view = chief.open_view("one", settings(100), pose(1.0, 1.0)).await.unwrap();
    frame(&mut view).await;
    let second = client(Some("chief")).await.open_view("", settings(100), pose(1.0, 1.0)).await;
    refusal(second, Code::ResourceExhausted, "limits.views_per_client");
}
