"""Telemetry and diagnoses in shared memory: layouts, services and ports, for programs in Python.

Specified in schemas/README.md, "Live telemetry, shared memory". Needs Python 3.9 or newer and

    pip install iceoryx2==0.10.0

    python ema_stream.py        prints the layouts; checks their names if `blake3` is installed
"""

import ctypes
import os
import re
import signal
import sys
import time
from importlib.metadata import version

INSTALL = "pip install iceoryx2==0.10.0"
try:
    import iceoryx2 as iox2
except ImportError as e:
    sys.exit(f"ema_stream: no iceoryx2 ({e}): {INSTALL}")
if not version("iceoryx2").startswith("0.10."):
    # processes of different versions do not see each other, silently
    sys.exit(f"ema_stream: iceoryx2 {version('iceoryx2')}; allowed: 0.10: {INSTALL}")

SCHEMA_VERSION = 1

# Channel number n, bit n of FrameHeader.channels: (name, unit).
CHANNELS = (
    ("com", "rad"), ("theta_u", "rad"), ("theta_m", "rad"), ("omega_m", "rad/s"),
    ("i_eq", "A"), ("i_a", "A"), ("i_b", "A"), ("i_c", "A"),
    ("v_a", "V"), ("v_b", "V"), ("v_c", "V"), ("torque_m", "N m"),
    ("i_q", "A"), ("i_supply", "A"), ("v_dc", "V"), ("temperature", "deg C"),
)  # fmt: skip
NAMES = tuple(name for name, _ in CHANNELS)

# Services; TELEMETRY and DIAGNOSIS have an event service of the same name.
TELEMETRY, DIAGNOSIS, ACKNOWLEDGEMENT = "ema/telemetry", "ema/diagnosis", "ema/acknowledgement"

# Settings of the services: a process that asks for more than the creator did is refused.
BUFFER_FRAMES = 512
MAX_BORROWED = 8
MAX_SUBSCRIBERS = 8
MAX_PUBLISHERS = 64
MAX_NODES = 128
MAX_EVENT_PORTS = 128
DIAGNOSIS_HISTORY = 64
DIAGNOSIS_BUFFER = 512
ALIGNMENT = 64
STRIDE_ROWS = 8
MAX_LOANS = 4

# Kinds of frames.
BEGIN, SAMPLES, END = 1, 2, 3

OUTCOMES = {1: "located", 2: "unexplained", 3: "out_of_range", 4: "incomplete"}

# Feature number n, bit n of DiagnosisMessage.contradicting: (name, unit). The last one has no map and no bit.
FEATURES = (
    ("p1", "rad/s"), ("p2", "A"), ("p3", "-"), ("ripple", "rad/s"), ("speed_loss", "rad/s"), ("rise", "s"),
    ("current_rms", "A"), ("sine_travel", "rad"), ("current_sum", "A"), ("current_imbalance", "-"),
    ("even_current", "A"), ("bias_current", "A"), ("p3", "rad"),
)  # fmt: skip
ENDINGS = {"rad/s": "_rad_per_s", "rad": "_rad", "A": "_a", "s": "_s", "-": ""}
# Fields of DiagnosisMessage and keys of logs.
FEATURE_KEYS = tuple(name + ENDINGS[unit] for name, unit in FEATURES)

U32, U64, I64, F64 = ctypes.c_uint32, ctypes.c_uint64, ctypes.c_int64, ctypes.c_double


class FrameHeader(ctypes.Structure):
    """User header of a telemetry frame."""

    _fields_ = [
        ("schema_version", U32), ("kind", U32), ("actuator", ctypes.c_char * 32),
        ("parameters", U64), ("sensors", U64), ("sequence", U64), ("run", U64),
        ("stream", U64), ("frame", U64), ("first", U64), ("first_ns", I64),
        ("total_rows", U64), ("publish_ns", U64), ("rate_hz", F64), ("load_n_m", F64),
        ("rows", U32), ("stride", U32), ("channels", U32), ("process", U32),
    ]  # fmt: skip

    @staticmethod
    def type_name():
        return "ema::FrameHeader/1/385abc4e"

    def names(self):
        """Channels of the frame, in the order of its columns."""
        return [name for n, name in enumerate(NAMES) if self.channels >> n & 1]

    def set_rows(self, first, rows):
        """Samples of a frame: number of the first one, and how many."""
        self.first, self.rows = first, rows
        self.first_ns = round(first / self.rate_hz * 1e9)
        self.stride = -(-rows // STRIDE_ROWS) * STRIDE_ROWS


class Acknowledgement(ctypes.Structure):
    """A subscriber's answer to BEGIN or END."""

    _fields_ = [("stream", U64), ("subscriber", U64), ("kind", U32), ("process", U32), ("frames", U64)]

    @staticmethod
    def type_name():
        return "ema::Acknowledgement/1/bae139b6"


class DiagnosisMessage(ctypes.Structure):
    """A diagnosis; NaN where a value is not known."""

    _fields_ = [
        ("schema_version", U32), ("outcome", U32), ("is_final", U32), ("contradicting", U32),
        ("actuator", ctypes.c_char * 32), ("parameters", U64), ("sequence", U64), ("run", U64),
        ("stream", U64), ("number", U64),
        ("fsj_lo", F64), ("fsj_hi", F64), ("fsj_estimate", F64),
        ("zeta_lo", F64), ("zeta_hi", F64), ("zeta_estimate", F64),
        ("area", F64), ("coverage", F64),
        *((key, F64) for key in FEATURE_KEYS),
        ("samples_received", U64), ("samples_lost", U64), ("telemetry_ns", U64), ("publish_ns", U64),
        ("reason", ctypes.c_char * 512),
    ]  # fmt: skip

    @staticmethod
    def type_name():
        return "ema::DiagnosisMessage/1/1a5ce51e"


class StreamError(Exception):
    """One line: what cannot be done with the shared memory, and why."""


class BadInput(Exception):
    """One line: place, value found, what is allowed."""


def text(field):
    """Text of a fixed field."""
    return field.decode("utf-8", "replace")


def to_text(value, size):
    """UTF-8 for a fixed field, cut at a character's end."""
    return value.encode()[:size].decode("utf-8", "ignore").encode()


def to_number(fingerprint):
    """A fingerprint as a number: `none` is 0, unknown (empty) is all ones."""
    if fingerprint in ("none", ""):
        return 0 if fingerprint else 2**64 - 1
    if not re.fullmatch("[0-9a-fA-F]{16}", fingerprint):
        raise BadInput(f"fingerprint: found `{fingerprint}`; allowed: 16 hexadecimal digits")
    return int(fingerprint, 16)


def from_number(number):
    """The fingerprint of a number of `to_number`."""
    return {0: "none", 2**64 - 1: ""}.get(number, f"{number:016x}")


def now_ns():
    """The clock of all time stamps (CLOCK_MONOTONIC) [ns]."""
    return time.clock_gettime_ns(time.CLOCK_MONOTONIC)


# ---------------------------------------------------------------------------------------- services


class Domain:
    """Processes of one domain see each other. `name`, or else EMA_DOMAIN; empty: iceoryx2's default."""

    def __init__(self, name=None):
        iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
        name = os.environ.get("EMA_DOMAIN", "") if name is None else name
        if not re.fullmatch("[A-Za-z0-9-]{0,32}", name):
            raise BadInput(f"domain: found `{name}`; allowed: up to 32 letters, digits and -")
        self.config = iox2.config.global_config()
        if name:
            self.config.global_cfg.prefix = iox2.FileName.new(name + "_")
        builder = iox2.NodeBuilder.new().config(self.config)
        # Python keeps Ctrl-C
        builder = builder.signal_handling_mode(iox2.SignalHandlingMode.Disabled)
        try:
            self.node = builder.create(iox2.ServiceType.Ipc)
        except Exception as e:
            raise StreamError(f"shared memory: no node ({e})") from e
        # what dead processes left
        self.node.blocking_cleanup_dead_nodes(iox2.Duration.from_millis(500))

    def telemetry(self):
        service = self.node.service_builder(iox2.ServiceName.new(TELEMETRY))
        service = service.publish_subscribe(iox2.Slice[Block]).user_header(FrameHeader)
        service = service.payload_alignment(iox2.Alignment.new(ALIGNMENT)).enable_safe_overflow(False)
        service = service.max_publishers(MAX_PUBLISHERS).max_subscribers(MAX_SUBSCRIBERS).max_nodes(MAX_NODES)
        service = service.history_size(0).subscriber_max_buffer_size(BUFFER_FRAMES)
        return self._open(TELEMETRY, FrameHeader, service.subscriber_max_borrowed_samples(MAX_BORROWED))

    def acknowledgements(self):
        service = self.node.service_builder(iox2.ServiceName.new(ACKNOWLEDGEMENT))
        service = service.publish_subscribe(Acknowledgement)
        # whoever subscribes to telemetry publishes answers
        service = service.max_publishers(MAX_SUBSCRIBERS).max_subscribers(MAX_PUBLISHERS).max_nodes(MAX_NODES)
        return self._open(ACKNOWLEDGEMENT, Acknowledgement, service.subscriber_max_buffer_size(BUFFER_FRAMES))

    def diagnoses(self):
        service = self.node.service_builder(iox2.ServiceName.new(DIAGNOSIS))
        service = service.publish_subscribe(DiagnosisMessage)
        service = service.max_publishers(MAX_PUBLISHERS).max_subscribers(MAX_SUBSCRIBERS).max_nodes(MAX_NODES)
        service = service.history_size(DIAGNOSIS_HISTORY).subscriber_max_buffer_size(DIAGNOSIS_BUFFER)
        return self._open(DIAGNOSIS, DiagnosisMessage, service)

    def events(self, name):
        service = self.node.service_builder(iox2.ServiceName.new(name)).event().max_nodes(MAX_NODES)
        service = service.max_listeners(MAX_EVENT_PORTS).max_notifiers(MAX_EVENT_PORTS)
        try:
            return service.open_or_create()
        except Exception as e:
            raise StreamError(f"{name}: event service cannot be opened ({e})") from e

    def _open(self, name, struct, builder):
        try:
            return builder.open_or_create()
        except Exception as e:
            wanted = struct.type_name()
            pattern = iox2.MessagingPattern.PublishSubscribe
            service = iox2.ServiceName.new(name)
            details = iox2.Service.details(service, self.config, pattern, iox2.ServiceType.Ipc)
            found = [n for n in re.findall(r'data: "(ema::[^"]*)"', str(details)) if n != wanted]
            if found:
                place = "schema version of those who are connected"
                raise BadInput(f"{name}: {place}: found {found[0]}; allowed: {wanted}") from e
            raise StreamError(f"{name}: cannot be opened ({e})") from e


def _port(name, what, create):
    try:
        return create()
    except Exception as e:
        raise StreamError(f"{name}: no {what} ({e})") from e


def _wait(listener, seconds):
    """Sleeps until there is an event, at most `seconds` and never so long that Ctrl-C is not heard."""
    try:
        listener.timed_wait(iox2.Duration.from_secs_f64(max(0.0, min(seconds, 0.5))))
    except iox2.ListenerWaitError as e:
        if "Interrupt" not in str(e):
            raise StreamError(f"cannot be waited for ({e})") from e


# ------------------------------------------------------------------------------------------ frames


class Block(ctypes.Structure):
    """Element of a frame's payload: 64 bytes."""

    _fields_ = [("values", F64 * STRIDE_ROWS)]

    @staticmethod
    def type_name():
        return "[f64; 8]"


class Frame:
    """A frame in shared memory, received or loaned.

    `header` is a copy. Columns lie where the publisher wrote them; they stay valid as long as
    they or the frame are referenced, and no more than MAX_BORROWED frames may be held at once.
    """

    def __init__(self, sample, header=None):
        self.sample = sample
        self.is_loaned = header is not None
        self.header = header or FrameHeader.from_buffer_copy(sample.user_header().contents)
        self.values = sample.payload().len() * STRIDE_ROWS

    def fault(self):
        """Why the frame cannot be read, or None."""
        h = self.header
        if h.schema_version != SCHEMA_VERSION:
            return f"schema version {h.schema_version}; allowed: {SCHEMA_VERSION}"
        if not 0 < h.rate_hz < float("inf"):
            return f"rate {h.rate_hz} Hz; allowed: a finite rate above 0"
        if h.channels >> len(CHANNELS):
            return f"channel bits {h.channels:#x}; allowed: channels of the table"
        if h.kind not in (BEGIN, SAMPLES, END):
            return f"kind {h.kind}; allowed: 1 begin, 2 samples, 3 end"
        if h.kind == SAMPLES:
            if not 0 < h.rows <= h.stride or h.stride % STRIDE_ROWS:
                return f"{h.rows} rows at a stride of {h.stride}; allowed: 1 to stride, a multiple of 8"
            if h.first == 0:
                return "first sample 0; allowed: from 1 on"
            if self.values < h.stride * len(h.names()):
                return f"truncated: {self.values} values; needed: {h.stride * len(h.names())}"
        return None

    def columns(self):
        """Yields (channel name, memoryview of f64) in place: read-only if received."""
        if self.header.kind != SAMPLES:
            return
        memory = (F64 * self.values).from_address(self.sample.payload_ptr)
        memory.owner = self.sample
        view = memoryview(memory).cast("B").cast("d")
        view = view if self.is_loaned else view.toreadonly()
        for i, name in enumerate(self.header.names()):
            start = i * self.header.stride
            yield name, view[start : start + self.header.rows]

    def arrays(self):
        """The same as numpy arrays, in place too."""
        import numpy

        for name, column in self.columns():
            yield name, numpy.frombuffer(column)


# ------------------------------------------------------------------------------------------- ports


class TelemetrySubscriber:
    """Receives the frames of all publishers of a domain."""

    def __init__(self, domain):
        service = domain.telemetry()
        # the answering port first: who sees this subscriber shall be able to hear it
        answers = domain.acknowledgements().publisher_builder()
        self.answers = _port(ACKNOWLEDGEMENT, "publisher", answers.create)
        self.listener = _port(TELEMETRY, "listener", domain.events(TELEMETRY).listener_builder().create)
        self.port = _port(TELEMETRY, "subscriber", service.subscriber_builder().create)
        number = self.port.id.value
        self.id = (number >> 64 ^ number) & (2**64 - 1)

    def receive(self):
        """The next frame, or None."""
        try:
            sample = self.port.receive()
        except Exception as e:
            raise StreamError(f"{TELEMETRY}: cannot be received ({e})") from e
        return sample and Frame(sample)

    def wait(self, seconds):
        _wait(self.listener, seconds)

    def answer(self, header, frames):
        """Answers BEGIN or END; `frames`: sample frames that came before the first gap."""
        self.answers.send_copy(Acknowledgement(header.stream, self.id, header.kind, os.getpid(), frames))


class TelemetryPublisher:
    """Sends frames of at most `rows` samples of `channels` channels."""

    def __init__(self, domain, rows, channels):
        self.node = domain.node
        self.service = domain.telemetry()
        values = -(-rows // STRIDE_ROWS) * STRIDE_ROWS * channels
        self._room(values)
        builder = self.service.publisher_builder().initial_max_slice_len(values // STRIDE_ROWS)
        builder = builder.max_loaned_samples(MAX_LOANS)
        # one block of fixed size; a full queue never blocks the interpreter
        builder = builder.allocation_strategy(iox2.AllocationStrategy.Static)
        builder = builder.backpressure_strategy(iox2.BackpressureStrategy.DiscardData)
        self.port = _port(TELEMETRY, "publisher", builder.create)
        answers = domain.acknowledgements().subscriber_builder()
        self.acknowledgements = _port(ACKNOWLEDGEMENT, "subscriber", answers.create)
        self.notifier = _port(TELEMETRY, "notifier", domain.events(TELEMETRY).notifier_builder().create)

    @staticmethod
    def _room(values):
        """Refuses what shared memory cannot hold, rather than being killed when it is full."""
        if os.path.isdir("/dev/shm"):
            frames = MAX_SUBSCRIBERS * (BUFFER_FRAMES + MAX_BORROWED) + MAX_LOANS + 1
            needed = frames * (values * 8 + ctypes.sizeof(FrameHeader) + 256)
            fs = os.statvfs("/dev/shm")
            if needed > fs.f_bavail * fs.f_frsize:
                found = f"found {fs.f_bavail * fs.f_frsize // 10**6} MB free"
                raise BadInput(f"/dev/shm: {found}; allowed: {needed // 10**6} MB (or shorter frames)")

    def subscribers(self):
        """Subscribers that are connected now, dead ones included until they are cleaned away."""
        return self.service.dynamic_config.number_of_subscribers

    def clean(self):
        """Removes what dead processes left."""
        self.node.try_cleanup_dead_nodes()

    def loan(self, header):
        """A frame of `header`, to be filled column by column."""
        blocks = header.stride // STRIDE_ROWS * len(header.names()) if header.kind == SAMPLES else 1
        try:
            sample = self.port.loan_slice_uninit(blocks)
        except Exception as e:
            raise StreamError(f"{TELEMETRY}: no memory for a frame ({e})") from e
        return Frame(sample, header)

    def send(self, frame):
        """Publishes a loaned frame; returns how many subscribers got it."""
        frame.header.publish_ns = now_ns()
        ctypes.memmove(frame.sample.user_header_ptr, ctypes.byref(frame.header), ctypes.sizeof(FrameHeader))
        try:
            reached = frame.sample.assume_init().send()
        except Exception as e:
            raise StreamError(f"{TELEMETRY}: cannot be sent ({e})") from e
        self.notifier.notify()
        return reached

    def answers(self, stream, kind):
        """Yields the answers to BEGIN or END of a stream that have come in."""
        while sample := self.acknowledgements.receive():
            a = Acknowledgement.from_buffer_copy(sample.payload().contents)
            if (a.stream, a.kind) == (stream, kind):
                yield a


class DiagnosisSubscriber:
    """Receives the diagnoses of a domain; `history`: that many sent before, at most DIAGNOSIS_HISTORY."""

    def __init__(self, domain, history=0):
        service = domain.diagnoses()
        self.listener = _port(DIAGNOSIS, "listener", domain.events(DIAGNOSIS).listener_builder().create)
        builder = service.subscriber_builder().buffer_size(DIAGNOSIS_BUFFER).history_request(history)
        self.port = _port(DIAGNOSIS, "subscriber", builder.create)

    def next(self, seconds):
        """The next diagnosis, or None when `seconds` are over."""
        end = time.monotonic() + seconds
        while True:
            try:
                sample = self.port.receive()
            except Exception as e:
                raise StreamError(f"{DIAGNOSIS}: cannot be received ({e})") from e
            if sample:
                return DiagnosisMessage.from_buffer_copy(sample.payload().contents)
            left = end - time.monotonic()
            if left <= 0:
                return None
            _wait(self.listener, left)


# ---------------------------------------------------------------------------------------- programs


def run(main):
    """Runs a program: one line on errors; exit code 1 failure, 4 bad input, 130 interrupted."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    program = os.path.splitext(os.path.basename(sys.argv[0]))[0]
    try:
        code = main()
        sys.stdout.flush()
    except (StreamError, BadInput) as e:
        print(f"{program}: {e}", file=sys.stderr)
        code = 4 if isinstance(e, BadInput) else 1
    except KeyboardInterrupt:
        code = 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 0
    sys.exit(code)


def layout(struct):
    """`field:type@offset;` of every field, as in the fingerprint of the structure's name."""
    kinds = {U32: "u32", U64: "u64", I64: "i64", F64: "f64"}
    for field, kind in struct._fields_:
        kind = kinds.get(kind) or f"[u8; {ctypes.sizeof(kind)}]"
        yield f"{field}:{kind}@{getattr(struct, field).offset};"


def main():
    table = ";".join(f"{name} {unit}" for name, unit in CHANNELS)
    for struct, more in ((FrameHeader, table), (DiagnosisMessage, ""), (Acknowledgement, "")):
        print(f"{struct.type_name()}, {ctypes.sizeof(struct)} bytes")
        print("".join(f"    {line}\n" for line in layout(struct)), end="")
        try:
            import blake3
        except ImportError:
            continue
        digits = blake3.blake3(("".join(layout(struct)) + more).encode()).hexdigest()[:8]
        name = f"ema::{struct.__name__}/{SCHEMA_VERSION}/{digits}"
        if name != struct.type_name():
            raise StreamError(f"the name of this layout is {name}, not {struct.type_name()}")
        print("    name checked")
    return 0


if __name__ == "__main__":
    run(main)
