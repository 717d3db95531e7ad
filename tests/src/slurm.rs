//! A Slurm cluster of one node, for one test: own daemons, ports and folders; gone when the test
//! ends, also when it panics or is killed. Neither root nor system services are needed.

use std::{
    fmt, fs,
    io::{Read, Write},
    net::TcpListener,
    os::unix::{fs::OpenOptionsExt, process::CommandExt},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

/// Processors that the node claims to have; more than most test machines have.
const CPUS: u32 = 8;

/// Starts the daemons, waits until its standard input ends (the test has dropped [`Slurm`], or is
/// dead), then stops them and all that they started. The state is thrown away: SIGKILL will do.
/// Jobs outlive slurmd. All processes of the cluster, and only they, have its SLURM_CONF.
const SUPERVISOR: &str = r#"
cd "$(dirname "$SLURM_CONF")" || exit 1
munged --foreground --force --key-file=munge/key --socket="$PWD/munge/socket" --pid-file=munge/pid \
    --log-file=munge/log --seed-file=munge/seed --num-threads=4 </dev/null >munged.log 2>&1 &
daemons=$!
tries=0
until [ -S munge/socket ] || [ $tries -ge 100 ]; do sleep 0.05; tries=$((tries + 1)); done
slurmctld -D </dev/null >slurmctld.log 2>&1 &
daemons="$daemons $!"
slurmd -D </dev/null >slurmd.log 2>&1 &
daemons="$daemons $!"
while read -r _; do :; done
kill -9 $daemons 2>/dev/null
wait
tries=0
while [ $tries -lt 20 ]; do
    found=
    for file in $(grep -lsxzF "SLURM_CONF=$SLURM_CONF" /proc/[0-9]*/environ); do
        id=${file#/proc/}
        id=${id%/environ}
        # neither this shell nor the grep, which has ended
        if [ "$id" != $$ ] && kill -9 "$id" 2>/dev/null; then found=1; fi
    done
    [ -z "$found" ] && break
    tries=$((tries + 1))
    sleep 0.05
done
"#;

/// A cluster that runs as long as the value lives.
pub struct Slurm {
    dir: PathBuf,
    supervisor: Child,
}

/// A job, or a task of an array job.
#[derive(Clone, Debug)]
pub struct Task {
    /// its place in the array
    pub index: Option<u32>,
    /// as Slurm names it: PENDING, RUNNING, COMPLETING, COMPLETED, FAILED, CANCELLED, ...
    pub state: String,
    /// why it waits
    pub reason: String,
    /// wait status: 256 times the exit code, plus the signal that ended it
    pub status: u32,
    /// how often it was requeued
    pub restarts: u32,
}

impl Task {
    pub fn pending(&self) -> bool {
        self.state == "PENDING"
    }

    pub fn running(&self) -> bool {
        self.state == "RUNNING"
    }

    pub fn completed(&self) -> bool {
        self.state == "COMPLETED"
    }

    /// ended, and will not run again by itself
    pub fn over(&self) -> bool {
        !matches!(
            self.state.as_str(),
            "PENDING" | "CONFIGURING" | "RUNNING" | "COMPLETING" | "SUSPENDED" | "REQUEUED"
        )
    }

    /// exit code, if the task ended by itself
    pub fn exit(&self) -> Option<u32> {
        (self.over() && self.status.is_multiple_of(256)).then_some(self.status / 256)
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.index {
            Some(index) => write!(f, "task {index}: ")?,
            None => write!(f, "job: ")?,
        }
        let Self {
            state,
            reason,
            status,
            restarts,
            ..
        } = self;
        write!(f, "{state} ({reason}), status {status}, {restarts} restarts")
    }
}

impl Slurm {
    /// Starts a cluster with its files in `dir`, an existing folder with a short path (sockets are
    /// made in it). `None`, with a line that says why, if Slurm is not installed or does not start.
    pub fn start(dir: &Path) -> Option<Self> {
        for program in [
            "munged",
            "slurmctld",
            "slurmd",
            "sbatch",
            "scancel",
            "scontrol",
            "squeue",
        ] {
            if !search_path()
                .split(':')
                .any(|folder| Path::new(folder).join(program).is_file())
            {
                println!("skipped: Slurm is not installed (no {program})");
                return None;
            }
        }
        // a port may be taken between choice and use
        for _ in 0..3 {
            match Self::try_start(dir) {
                Ok(slurm) => return Some(slurm),
                Err(reason) => println!("Slurm does not start: {reason}"),
            }
        }
        println!("skipped: Slurm does not start");
        None
    }

    fn try_start(dir: &Path) -> Result<Self, String> {
        let dir = dir.canonicalize().map_err(|e| e.to_string())?;
        configure(&dir).map_err(|e| e.to_string())?;
        let supervisor = cluster_command(&dir, "sh")
            .args(["-c", SUPERVISOR])
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            // Ctrl-C is for the test; the supervisor sees the end of the test
            .process_group(0)
            .spawn()
            .map_err(|e| e.to_string())?;
        let slurm = Self { dir, supervisor };
        // clients that find no munged try again for a minute
        let ready = slurm.wait_until(Duration::from_secs(10), || slurm.dir.join("munge/socket").exists())
            && slurm.wait_until(Duration::from_secs(20), || {
                slurm
                    .output("sinfo", &["--noheader", "--format=%T"])
                    .is_ok_and(|state| state.trim() == "idle")
            });
        if ready { Ok(slurm) } else { Err(slurm.log()) }
    }

    /// A command that sees this cluster and no other.
    pub fn command(&self, program: &str) -> Command {
        cluster_command(&self.dir, program)
    }

    fn output(&self, program: &str, args: &[&str]) -> Result<String, String> {
        let output = self.command(program).args(args).output().map_err(|e| e.to_string())?;
        if output.status.success() {
            Ok(String::from_utf8_lossy(&output.stdout).into_owned())
        } else {
            Err(format!(
                "{program} {}: {}",
                args.join(" "),
                String::from_utf8_lossy(&output.stderr)
            ))
        }
    }

    /// Runs a client program (`scancel`, `scontrol`, ...) and gives what it prints.
    ///
    /// # Panics
    /// if it fails.
    pub fn run(&self, program: &str, args: &[&str]) -> String {
        self.output(program, args).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Submits a job and gives its number.
    pub fn sbatch(&self, args: &[&str]) -> u32 {
        let printed = self.run("sbatch", &[&["--parsable"], args].concat());
        printed
            .trim()
            .parse()
            .unwrap_or_else(|_| panic!("job number: {printed}"))
    }

    /// The job's tasks, by index; one task if it is no array.
    pub fn tasks(&self, job: u32) -> Vec<Task> {
        let job = job.to_string();
        let columns = "JobArrayID:30|,State:30|,Reason:60|,exit_code:12|,RestartCnt:12";
        let table = self.run(
            "squeue",
            &[
                "--noheader",
                "--array",
                "--states=all",
                "--jobs",
                &job,
                "--Format",
                columns,
            ],
        );
        let mut tasks: Vec<Task> = table
            .lines()
            .map(|line| {
                let cells: Vec<&str> = line.split('|').map(str::trim).collect();
                let [id, state, reason, status, restarts] = cells[..] else {
                    panic!("squeue: {line}")
                };
                Task {
                    index: id.split_once('_').map(|(_, index)| index.parse().expect("array index")),
                    state: state.to_owned(),
                    reason: reason.to_owned(),
                    status: status.parse().unwrap_or(0),
                    restarts: restarts.parse().unwrap_or(0),
                }
            })
            .collect();
        tasks.sort_by_key(|task| task.index);
        tasks
    }

    /// Waits until all tasks of the job are over.
    ///
    /// # Panics
    /// after `limit`, with the state of the job.
    pub fn wait(&self, job: u32, limit: Duration) -> Vec<Task> {
        let mut tasks = Vec::new();
        let over = self.wait_until(limit, || {
            tasks = self.tasks(job);
            !tasks.is_empty() && tasks.iter().all(Task::over)
        });
        if !over {
            let states: Vec<String> = tasks.iter().map(Task::to_string).collect();
            panic!(
                "job {job} is not over after {limit:?}\n{}\n{}",
                states.join("\n"),
                self.log()
            );
        }
        tasks
    }

    /// Requeues a running task and lets it start again at once; by itself it would wait for two minutes
    /// (`cred_expire`, which may be short, but then a busy machine starts its tasks too late).
    ///
    /// # Panics
    /// if the task does not run, or does not end.
    pub fn requeue(&self, job: u32, index: u32) {
        let id = format!("{job}_{index}");
        self.run("scontrol", &["requeue", &id]);
        let waits = self.wait_until(Duration::from_secs(30), || {
            self.tasks(job)
                .iter()
                .any(|task| task.index == Some(index) && task.pending())
        });
        assert!(waits, "task {id} does not end\n{}", self.log());
        // credentials of the second in which it ended are revoked: started at once, it would fail
        sleep(Duration::from_millis(2100));
        self.run("scontrol", &["update", &format!("JobId={id}"), "StartTime=now"]);
    }

    /// Asks every 50 ms until `done`; false after `limit`.
    pub fn wait_until(&self, limit: Duration, mut done: impl FnMut() -> bool) -> bool {
        let start = Instant::now();
        loop {
            if done() {
                return true;
            }
            if start.elapsed() > limit {
                return false;
            }
            sleep(Duration::from_millis(50));
        }
    }

    /// Processes named `program` that work for a task.
    pub fn processes(&self, job: u32, index: u32, program: &str) -> Vec<u32> {
        let conf = format!("SLURM_CONF={}", self.dir.join("slurm.conf").display());
        let wanted = [
            conf,
            format!("SLURM_ARRAY_JOB_ID={job}"),
            format!("SLURM_ARRAY_TASK_ID={index}"),
        ];
        let Ok(entries) = fs::read_dir("/proc") else {
            return Vec::new();
        };
        entries
            .flatten()
            .filter_map(|entry| {
                let id = entry.file_name().to_str()?.parse().ok()?;
                let name = fs::read_to_string(entry.path().join("comm")).ok()?;
                // the kernel keeps 15 bytes of the name
                if name.trim_end() != program.get(..15).unwrap_or(program) {
                    return None;
                }
                let environment = fs::read(entry.path().join("environ")).ok()?;
                let has = |line: &String| environment.split(|&byte| byte == 0).any(|have| have == line.as_bytes());
                wanted.iter().all(has).then_some(id)
            })
            .collect()
    }

    /// SIGKILL to a process.
    pub fn kill(&self, process: u32) {
        let _ = Command::new("sh").args(["-c", &format!("kill -9 {process}")]).status();
    }

    /// The last lines of the daemons, for messages.
    pub fn log(&self) -> String {
        let mut text = String::new();
        for name in ["munged.log", "slurmctld.log", "slurmd.log"] {
            let log = fs::read_to_string(self.dir.join(name)).unwrap_or_default();
            let lines: Vec<&str> = log.lines().collect();
            text += &format!("== {name}\n{}\n", lines[lines.len().saturating_sub(30)..].join("\n"));
        }
        text
    }
}

impl Drop for Slurm {
    fn drop(&mut self) {
        drop(self.supervisor.stdin.take());
        let _ = self.supervisor.wait();
    }
}

/// Daemons are often outside the path of ordinary users.
fn search_path() -> String {
    format!(
        "{}:/usr/sbin:/usr/local/sbin",
        std::env::var("PATH").unwrap_or_default()
    )
}

fn cluster_command(dir: &Path, program: &str) -> Command {
    let mut command = Command::new("env");
    // what a surrounding cluster or job has set is not for this one
    for (name, _) in std::env::vars_os() {
        let name_text = name.to_string_lossy();
        if ["SLURM_", "SBATCH_", "SQUEUE_", "SINFO_", "SCANCEL_"]
            .iter()
            .any(|prefix| name_text.starts_with(prefix))
        {
            command.env_remove(&name);
        }
    }
    command
        .arg(program)
        .env("PATH", search_path())
        .env("SLURM_CONF", dir.join("slurm.conf"));
    command
}

/// Writes slurm.conf and the key of munge.
fn configure(dir: &Path) -> std::io::Result<()> {
    let folder = dir.join("munge");
    fs::create_dir_all(&folder)?;
    fs::create_dir_all(dir.join("state"))?;
    fs::create_dir_all(dir.join("spool"))?;
    let _ = fs::remove_file(folder.join("socket"));
    // who has the key may run jobs as any user
    let mut key = [0; 128];
    fs::File::open("/dev/urandom")?.read_exact(&mut key)?;
    let key_file = folder.join("key");
    let _ = fs::remove_file(&key_file);
    fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&key_file)?
        .write_all(&key)?;

    // both are held until both are chosen
    let (first, second) = (TcpListener::bind("127.0.0.1:0")?, TcpListener::bind("127.0.0.1:0")?);
    let (controller, node) = (first.local_addr()?.port(), second.local_addr()?.port());
    let host = fs::read_to_string("/proc/sys/kernel/hostname")?;
    let host = host.trim().split('.').next().unwrap_or_default();
    let user = Command::new("id").arg("-un").output()?.stdout;
    let user = String::from_utf8_lossy(&user);
    let user = user.trim();
    let dir_text = dir.display();
    let conf = format!(
        "ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={node}
SlurmUser={user}
SlurmdUser={user}
StateSaveLocation={dir_text}/state
SlurmdSpoolDir={dir_text}/spool
SlurmctldPidFile={dir_text}/slurmctld.pid
SlurmdPidFile={dir_text}/slurmd.pid
MailProg=/bin/true
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={dir_text}/munge/socket
# listen on this machine only
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
# neither cgroups nor accounting
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
# tasks start at once rather than after 3 to 60 s
SchedulerType=sched/backfill
SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1
# seconds from SIGTERM to SIGKILL
KillWait=2
# ended jobs can be asked for as long as the test runs
MinJobAge=3600
ReturnToService=2
# a busy machine is not a lost node
SlurmdTimeout=0
MessageTimeout=30
BatchStartTimeout=60
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
# more processors than the machine has
SlurmdParameters=config_overrides
NodeName={host} NodeAddr=127.0.0.1 CPUs={CPUS} RealMemory=65536
PartitionName=test Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"
    );
    fs::write(dir.join("slurm.conf"), conf)
}
