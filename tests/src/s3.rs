//! An S3 server in this process, for tests: real requests and signatures over loopback, files in a
//! temporary folder, and faults on demand.
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use s3s::auth::SimpleAuth;
use s3s::service::S3ServiceBuilder;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

pub const BUCKET: &str = "fleet";
pub const KEY: &str = "test-key";
pub const SECRET: &str = "test-secret";

/// Faults still to come, each counted down by the requests it meets.
#[derive(Default)]
pub struct Faults {
    /// Requests answered with 503 and not carried out.
    pub busy: AtomicUsize,
    /// Requests carried out whose answer is lost with the connection.
    pub lost: AtomicUsize,
    /// Conditional puts answered with 409 and not carried out, as by a store busy with the same name.
    pub conflict: AtomicUsize,
    /// Requests that came, faults included.
    pub seen: AtomicUsize,
}

impl Faults {
    fn take(count: &AtomicUsize) -> bool {
        count
            .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |n| n.checked_sub(1))
            .is_ok()
    }
}

/// The server; it stops when dropped.
pub struct S3Server {
    pub endpoint: String,
    pub bucket: String,
    pub faults: Arc<Faults>,
    folder: tempfile::TempDir,
    runtime: Option<tokio::runtime::Runtime>,
}

impl S3Server {
    /// Starts a server with one empty bucket on a free port.
    pub fn start() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        std::fs::create_dir(folder.path().join(BUCKET)).expect("a bucket");
        let files = s3s_fs::FileSystem::new(folder.path()).expect("a file system");
        let mut builder = S3ServiceBuilder::new(files);
        builder.set_auth(SimpleAuth::from_single(KEY, SECRET));
        let service = builder.build();
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .expect("a runtime");
        let listener = runtime
            .block_on(tokio::net::TcpListener::bind(("127.0.0.1", 0)))
            .expect("a free port");
        let endpoint = format!("http://{}", listener.local_addr().expect("an address"));
        let faults = Arc::new(Faults::default());
        let at_fault = faults.clone();
        // the file system behind looks and then writes: one conditional put at a time
        let one_by_one = Arc::new(tokio::sync::Mutex::new(()));
        runtime.spawn(async move {
            while let Ok((socket, _)) = listener.accept().await {
                let (service, faults, one_by_one) = (service.clone(), at_fault.clone(), one_by_one.clone());
                let answer = service_fn(move |request: hyper::Request<hyper::body::Incoming>| {
                    let (service, faults, one_by_one) = (service.clone(), faults.clone(), one_by_one.clone());
                    async move {
                        faults.seen.fetch_add(1, Ordering::SeqCst);
                        let conditional = request.headers().contains_key("if-none-match");
                        let refusal = if Faults::take(&faults.busy) {
                            Some((503, "SlowDown"))
                        } else if conditional && Faults::take(&faults.conflict) {
                            Some((409, "ConditionalRequestConflict"))
                        } else {
                            None
                        };
                        if let Some((status, code)) = refusal {
                            let body = format!("<Error><Code>{code}</Code><Message>come again</Message></Error>");
                            let mut refused = hyper::Response::new(s3s::Body::from(body));
                            *refused.status_mut() = hyper::StatusCode::from_u16(status).expect("a status");
                            return Ok(refused);
                        }
                        let _turn = match conditional {
                            true => Some(one_by_one.lock().await),
                            false => None,
                        };
                        let answer = service.call(request.map(s3s::Body::from)).await;
                        if Faults::take(&faults.lost) {
                            return Err(io::Error::from(io::ErrorKind::ConnectionAborted));
                        }
                        answer.map_err(|e| io::Error::other(format!("{e:?}")))
                    }
                });
                tokio::spawn(hyper::server::conn::http1::Builder::new().serve_connection(TokioIo::new(socket), answer));
            }
        });
        Self {
            endpoint,
            bucket: BUCKET.into(),
            faults,
            folder,
            runtime: Some(runtime),
        }
    }

    /// The URL of a prefix of the bucket.
    pub fn url(&self, prefix: &str) -> String {
        format!("s3://{}/{prefix}", self.bucket)
    }

    /// The environment variables of a client, for a child process or `Storage::open_with`.
    pub fn env(&self) -> Vec<(String, String)> {
        environment(&self.endpoint)
    }

    /// Where the objects of the bucket lie as files.
    pub fn files(&self) -> std::path::PathBuf {
        Path::join(self.folder.path(), BUCKET)
    }
}

impl Drop for S3Server {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_timeout(Duration::from_secs(1));
        }
    }
}

/// The variables for a server at `endpoint`.
pub fn environment(endpoint: &str) -> Vec<(String, String)> {
    [
        ("AWS_ENDPOINT_URL", endpoint),
        ("AWS_ALLOW_HTTP", "true"),
        ("AWS_ACCESS_KEY_ID", KEY),
        ("AWS_SECRET_ACCESS_KEY", SECRET),
        ("AWS_REGION", "us-east-1"),
    ]
    .map(|(name, value)| (name.to_owned(), value.to_owned()))
    .to_vec()
}
