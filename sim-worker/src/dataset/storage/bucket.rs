//! A dataset below a prefix of an S3 bucket.
use super::{Put, plain, unique, without_user};
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey as Key};
use object_store::client::{HttpError, HttpErrorKind};
use object_store::path::Path;
use object_store::{
    Attribute, BackoffConfig, ClientConfigKey, ClientOptions, Error as Refusal, GetOptions, GetRange, ObjectStore,
    PutMode, PutOptions, RetryConfig,
};
use schemas::error::{Error, Result};
use std::ops::Range;
use std::sync::OnceLock;
use std::time::Duration;
use tokio::runtime::{Builder, Handle, Runtime};

/// A conditional put carries this mark, by which it knows its own object when the answer was lost.
const MARK: &str = "ema-put";
/// How often a conditional put is sent again by us, beyond what the client repeats.
const TRIES: u32 = 5;

#[derive(Clone)]
pub(super) struct Bucket {
    store: AmazonS3,
    name: String,
    prefix: String,
    endpoint: String,
    region: String,
}

/// Without the client: it knows the secret.
impl std::fmt::Debug for Bucket {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.describe(""))
    }
}

impl Bucket {
    pub fn open(
        url: &str,
        name: &str,
        prefix: &str,
        settings: impl IntoIterator<Item = (String, String)>,
    ) -> Result<Self> {
        let settings = Settings::read(url, settings)?;
        runtime()?;
        let bucket = |patience| -> Result<Self> {
            Ok(Self {
                store: settings.client(url, name, patience)?,
                name: name.to_owned(),
                prefix: prefix.to_owned(),
                endpoint: settings.endpoint.clone(),
                region: settings.region.clone(),
            })
        };
        let lasting = bucket(Patience::Run)?;
        let no_role = |b: &Self, e: Refusal| match settings.keys || !e.to_string().contains("/latest/") {
            true => b.failed("", "cannot be reached", &e),
            false => Error::bad(
                url,
                "AWS_ACCESS_KEY_ID",
                "nothing, and no role of this machine",
                "a key, with AWS_SECRET_ACCESS_KEY",
            ),
        };
        match bucket(Patience::Start)?.touch() {
            // throttled by a crowd that starts at the same time: wait as long as in the run
            Err(e) if Cause::of(&e).passes() => lasting.touch().map_err(|e| no_role(&lasting, e))?,
            // may put and get, but not list
            Err(e) if Cause::of(&e).code == "AccessDenied" => {}
            touched => touched.map_err(|e| no_role(&lasting, e))?,
        }
        Ok(lasting)
    }

    /// Asks for the first page of the list.
    fn touch(&self) -> Result<(), Refusal> {
        let mut page = self.store.list(Some(&Path::from(self.prefix.as_str())));
        wait(async move { page.next().await.transpose().map(|_| ()) })
    }

    pub fn put_new(&self, path: &str, bytes: Bytes) -> Result<Put> {
        let at = self.key(path)?;
        let mark = unique();
        let metadata = Attribute::Metadata(MARK.into());
        let mut pause = Duration::from_millis(200);
        for attempt in 1.. {
            let options = PutOptions {
                mode: PutMode::Create,
                attributes: [(metadata.clone(), mark.clone())].into_iter().collect(),
                ..PutOptions::default()
            };
            match wait(self.store.put_opts(&at, bytes.clone().into(), options)) {
                Ok(_) => return Ok(Put::Made),
                Err(Refusal::AlreadyExists { .. }) => {
                    // ours, if an answer was lost and the client asked again; nobody's, if the
                    // store only said that it was busy with the name (409)
                    let options = GetOptions {
                        head: true,
                        ..GetOptions::default()
                    };
                    match wait(self.store.get_opts(&at, options)) {
                        Ok(found) if found.attributes.get(&metadata).is_some_and(|m| **m == *mark) => {
                            return Ok(Put::Made);
                        }
                        Ok(_) => return Ok(Put::Existed),
                        // may put, but not get
                        Err(e) if Cause::of(&e).status == 403 => return Ok(Put::Existed),
                        Err(Refusal::NotFound { .. }) if attempt < TRIES => {}
                        Err(e) => return Err(self.failed(path, "cannot be written", &e)),
                    }
                }
                Err(e) if attempt < TRIES && Cause::of(&e).lost => {}
                Err(e) => return Err(self.failed(path, "cannot be written", &e)),
            }
            std::thread::sleep(pause);
            pause *= 2;
        }
        unreachable!()
    }

    pub fn replace(&self, path: &str, bytes: Bytes) -> Result<()> {
        let at = self.key(path)?;
        wait(self.store.put_opts(&at, bytes.into(), PutOptions::default()))
            .map(|_| ())
            .map_err(|e| self.failed(path, "cannot be written", &e))
    }

    pub fn get(&self, path: &str) -> Result<Option<Bytes>> {
        self.read(path, GetOptions::default())
    }

    pub fn get_range(&self, path: &str, range: Range<u64>) -> Result<Option<Bytes>> {
        let options = GetOptions {
            range: Some(GetRange::Bounded(range)),
            ..GetOptions::default()
        };
        self.read(path, options)
    }

    fn read(&self, path: &str, options: GetOptions) -> Result<Option<Bytes>> {
        let at = self.key(path)?;
        let got = wait(async { self.store.get_opts(&at, options).await?.bytes().await });
        match got {
            // beyond the end: the caller compares the size
            Err(e) if Cause::of(&e).status == 416 => Ok(Some(Bytes::new())),
            got => self.there(path, got),
        }
    }

    pub fn head(&self, path: &str) -> Result<Option<u64>> {
        let at = self.key(path)?;
        let options = GetOptions {
            head: true,
            ..GetOptions::default()
        };
        let got = wait(self.store.get_opts(&at, options)).map(|found| found.meta.size);
        self.there(path, got)
    }

    fn there<T>(&self, path: &str, got: Result<T, Refusal>) -> Result<Option<T>> {
        match got {
            Ok(got) => Ok(Some(got)),
            Err(e @ Refusal::NotFound { .. }) if Cause::of(&e).code != "NoSuchBucket" => Ok(None),
            Err(e) => Err(self.failed(path, "cannot be read", &e)),
        }
    }

    pub fn list(&self, prefix: &str) -> Result<Vec<(String, u64)>> {
        let at = self.key(prefix)?;
        let skip = match self.prefix.as_str() {
            "" => 0,
            own => own.len() + 1,
        };
        let objects = self.store.list(Some(&at));
        let found = objects.map_ok(|o| (o.location.as_ref().get(skip..).unwrap_or_default().to_owned(), o.size));
        wait(found.try_collect()).map_err(|e| self.failed(prefix, "cannot be listed", &e))
    }

    pub fn delete(&self, paths: Vec<String>) -> Result<()> {
        let keys: Vec<_> = paths.iter().map(|p| self.key(p)).collect::<Result<_>>()?;
        let place = match paths.as_slice() {
            [one] => one.as_str(),
            _ => "",
        };
        let mut gone = self.store.delete_stream(stream::iter(keys.into_iter().map(Ok)).boxed());
        wait(async {
            while let Some(one) = gone.next().await {
                match one {
                    Ok(_) | Err(Refusal::NotFound { .. }) => {}
                    Err(e) => return Err(e),
                }
            }
            Ok(())
        })
        .map_err(|e| self.failed(place, "cannot be deleted", &e))
    }

    fn key(&self, path: &str) -> Result<Path> {
        let whole = match (self.prefix.as_str(), path) {
            ("", path) => path.to_owned(),
            (prefix, "") => prefix.to_owned(),
            (prefix, path) => format!("{prefix}/{path}"),
        };
        Path::parse(&whole)
            .map_err(|_| Error::bad(self.describe(""), "object name", format!("{path:?}"), "a plain name"))
    }

    pub fn url(&self, path: &str) -> String {
        let parts = ["s3:/", &self.name, &self.prefix, path];
        let parts: Vec<_> = parts.into_iter().filter(|p| !p.is_empty()).collect();
        parts.join("/")
    }

    pub fn describe(&self, path: &str) -> String {
        format!("{} at {}", self.url(path), self.endpoint)
    }

    /// One line: what of the answer helps to put it right, and never a header or a signature.
    fn failed(&self, path: &str, what: &str, e: &Refusal) -> Error {
        let cause = Cause::of(e);
        let bad = |place: &str, found: &str, allowed: &str| {
            let found = format!("{found}, says {} ({})", self.endpoint, cause.answer());
            Error::bad(self.url(""), place, found, allowed)
        };
        match (cause.status, cause.code.as_str()) {
            (404, _) => bad(
                "bucket",
                &format!("no bucket {}", self.name),
                "a bucket that was made before",
            ),
            (_, "InvalidAccessKeyId" | "NotSignedUp") => {
                bad("AWS_ACCESS_KEY_ID", "an unknown key", "a key of this store")
            }
            (_, "SignatureDoesNotMatch") => bad(
                "AWS_SECRET_ACCESS_KEY",
                "another secret than that of the key",
                "the secret of AWS_ACCESS_KEY_ID",
            ),
            (_, "ExpiredToken" | "InvalidToken") => bad("AWS_SESSION_TOKEN", "a token that does not hold", "a new one"),
            (301 | 307, _)
            | (_, "AuthorizationHeaderMalformed" | "PermanentRedirect" | "IllegalLocationConstraint") => bad(
                "AWS_REGION",
                &format!("{}, not the bucket's", self.region),
                "the region of the bucket",
            ),
            _ => Error::Stream {
                service: self.describe(path),
                why: match cause.status {
                    0 if cause.lost => format!("{what}: no answer: {}", cause.answer()),
                    0 => format!("{what}: {}", cause.answer()),
                    403 => format!("{what}: permission denied ({})", cause.answer()),
                    _ => format!("{what}: {}", cause.answer()),
                },
            },
        }
    }
}

/// How long a request is repeated.
#[derive(Clone, Copy)]
enum Patience {
    /// The first: a wrong endpoint must be found while somebody looks.
    Start,
    /// Later ones: the endpoint was there, and the work of hours is not thrown away for its pause.
    Run,
}

/// The `AWS_*` variables, looked through for what would fail late or in words that do not help.
struct Settings {
    given: Vec<(Key, String)>,
    endpoint: String,
    region: String,
    /// Whether credentials are named, so that the machine need not be asked for its role.
    keys: bool,
}

impl Settings {
    fn read(url: &str, settings: impl IntoIterator<Item = (String, String)>) -> Result<Self> {
        let mut given = Vec::new();
        let mut own_endpoint = None;
        let mut region = None;
        let mut keys = false;
        for (name, value) in settings {
            let Ok(key) = name.to_ascii_lowercase().parse::<Key>() else {
                continue;
            };
            if !name.starts_with("AWS_") || value.is_empty() {
                continue;
            }
            let refuse = |found: &str, allowed: &str| Err(Error::bad(url, &name, found, allowed));
            // a line end from a file; the value may be a secret and is not repeated
            if !value.chars().all(|c| c.is_ascii_graphic() || c == ' ') || value.trim() != value {
                return refuse("a line end, white space at an end, or no ASCII", "the value alone");
            }
            let s3_only = name == "AWS_ENDPOINT_URL_S3";
            match key {
                Key::Endpoint | Key::S3Endpoint => {
                    if !is_endpoint(&value) {
                        return refuse(&without_user(&value), "http://host:port or https://host:port");
                    }
                    if own_endpoint.is_none() || s3_only {
                        own_endpoint = Some((name.clone(), value.clone()));
                    }
                }
                Key::Region | Key::DefaultRegion => {
                    if !plain(&value) {
                        return refuse(&value, "a region, as eu-central-1");
                    }
                    if region.is_none() || matches!(key, Key::Region) {
                        region = Some(value.clone());
                    }
                }
                Key::AccessKeyId
                | Key::SecretAccessKey
                | Key::WebIdentityTokenFile
                | Key::ContainerCredentialsRelativeUri
                | Key::ContainerCredentialsFullUri
                | Key::SkipSignature => keys = true,
                // the bucket is that of the URL
                Key::Bucket => continue,
                _ => {}
            }
            given.push((key, value));
        }
        let plain_http = given
            .iter()
            .any(|(key, value)| matches!(key, Key::Client(ClientConfigKey::AllowHttp)) && truth(value));
        if let Some((name, value)) = own_endpoint.as_ref().filter(|(_, v)| v.starts_with("http:"))
            && !plain_http
        {
            let allowed = "https://..., or http://... with AWS_ALLOW_HTTP=true";
            return Err(Error::bad(url, name, without_user(value), allowed));
        }
        let region = region.unwrap_or_else(|| "us-east-1".into());
        let endpoint = match own_endpoint {
            Some((_, value)) => without_user(&value),
            None => format!("https://s3.{region}.amazonaws.com"),
        };
        Ok(Self {
            given,
            endpoint,
            region,
            keys,
        })
    }

    fn client(&self, url: &str, bucket: &str, patience: Patience) -> Result<AmazonS3> {
        let (connect, request, total, max_backoff) = match patience {
            Patience::Start => (2, 3, 5, 1),
            Patience::Run => (5, 300, 60, 5),
        };
        let options = ClientOptions::new()
            .with_connect_timeout(Duration::from_secs(connect))
            .with_timeout(Duration::from_secs(request));
        let retry = RetryConfig {
            backoff: BackoffConfig {
                init_backoff: Duration::from_millis(100),
                max_backoff: Duration::from_secs(max_backoff),
                base: 2.0,
            },
            max_retries: 50,
            retry_timeout: Duration::from_secs(total),
        };
        let mut builder = AmazonS3Builder::new().with_client_options(options);
        for (key, value) in &self.given {
            builder = builder.with_config(*key, value);
        }
        builder
            .with_region(&self.region)
            .with_bucket_name(bucket)
            .with_retry(retry)
            .build()
            .map_err(|e| {
                // of the client's words only the first line, and no value
                let why = clipped(e.to_string().trim_start_matches("Generic S3 error: "));
                Error::bad(url, "AWS_* variables", why, "a key with its secret, and valid values")
            })
    }
}

fn truth(value: &str) -> bool {
    ["1", "true", "on", "yes", "y"].contains(&value.to_ascii_lowercase().as_str())
}

/// Whether a request can be made of it: scheme, host, perhaps a port and a path.
fn is_endpoint(url: &str) -> bool {
    let Some(rest) = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://")) else {
        return false;
    };
    let (authority, path) = rest.split_once('/').unwrap_or((rest, ""));
    let (host, port) = match authority.rsplit_once(':') {
        Some((host, port)) if !port.contains(']') => (host, port.parse::<u16>().is_ok()),
        _ => (authority, true),
    };
    let six = host.strip_prefix('[').and_then(|h| h.strip_suffix(']'));
    let named = match six {
        Some(six) => six.parse::<std::net::Ipv6Addr>().is_ok(),
        None => !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || ".-_".contains(c)),
    };
    port && named && path.split('/').all(|p| p.is_empty() || plain(p))
}

/// What the client's long error says in the end.
struct Cause {
    /// HTTP status, 0 if there was no answer.
    status: u16,
    /// The store's word for it, or nothing.
    code: String,
    message: String,
    /// Whether the request may have been carried out although no answer came.
    lost: bool,
}

impl Cause {
    fn of(e: &Refusal) -> Self {
        let whole = e.to_string();
        let between = |a: &str, b: &str| {
            let from = whole.find(a)? + a.len();
            Some(whole[from..from + whole[from..].find(b)?].to_owned())
        };
        let status = between("status code: ", " ").and_then(|s| s.trim_end_matches(':').parse().ok());
        let redirect = whole.contains("redirect without LOCATION").then_some(301);
        let (mut message, mut lost) = (whole.clone(), false);
        let mut next: Option<&dyn std::error::Error> = Some(e);
        while let Some(one) = next {
            if let Some(http) = one.downcast_ref::<HttpError>() {
                lost = !matches!(http.kind(), HttpErrorKind::Connect);
            }
            message = one.to_string();
            next = one.source();
        }
        Self {
            status: status.or(redirect).unwrap_or(0),
            code: between("<Code>", "</Code>").unwrap_or_default(),
            message: between("<Message>", "</Message>").unwrap_or(message),
            lost,
        }
    }

    /// Whether the store asks to come again later.
    fn passes(&self) -> bool {
        self.status >= 500 || self.status == 429
    }

    fn answer(&self) -> String {
        match (self.status, self.code.as_str()) {
            (0, _) => clipped(&self.message),
            (status, "") => status.to_string(),
            (status, code) if status < 500 => clipped(&format!("{status} {code}")),
            (status, code) => clipped(&format!("{status} {code}: {}", self.message)),
        }
    }
}

/// One line of readable length.
fn clipped(text: &str) -> String {
    let line = text.lines().next().unwrap_or_default();
    line.chars().filter(|c| !c.is_control()).take(160).collect()
}

/// The runtime of all buckets. One worker drives the connections, also while nobody waits, so that
/// one that the other end has closed is not used again; signing is done by the calling threads.
fn runtime() -> Result<&'static Runtime> {
    static RUNTIME: OnceLock<std::result::Result<Runtime, String>> = OnceLock::new();
    let made = RUNTIME.get_or_init(|| {
        Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("storage")
            .enable_all()
            .build()
            .map_err(|e| e.to_string())
    });
    made.as_ref().map_err(|why| Error::Stream {
        service: "network".into(),
        why: why.clone(),
    })
}

/// Waits for an answer, also on a thread that belongs to another runtime.
fn wait<T: Send>(work: impl Future<Output = T> + Send) -> T {
    let runtime = runtime().expect("made when the bucket was opened");
    if Handle::try_current().is_err() {
        return runtime.block_on(work);
    }
    std::thread::scope(|s| match s.spawn(|| runtime.block_on(work)).join() {
        Ok(answer) => answer,
        Err(panic) => std::panic::resume_unwind(panic),
    })
}
