"""What each marked place of the documentation says of the results of its benchmarks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from textwrap import fill
from typing import Any

__all__ = ["TABLES", "TEXTS", "Results", "Row", "Text"]

Results = Mapping[str, Any]


@dataclass(frozen=True)
class Row:
    """A row of a table.

    Attributes
    ----------
    what : str
        What was measured.
    files : tuple of str
        Names of the JSON files that its figures come from, without ``.json``.
    measured : callable
        Writes the figures, given these files' contents.
    """

    what: str
    files: tuple[str, ...]
    measured: Callable[..., str]


@dataclass(frozen=True)
class Text:
    """A place that is no table of rows.

    Attributes
    ----------
    file : str
        Name of the JSON file that its figures come from, without ``.json``.
    written : callable
        Writes it in Markdown, given this file's contents.
    """

    file: str
    written: Callable[[Results], str]


def _span(values: list[float], form: str) -> str:
    """Write the lowest and the highest of some values."""
    return f"{min(values):{form}} to {max(values):{form}}"


# ----------------------------------------------------------------------------------------- loading


def _windows(r: Results) -> str:
    return f"{r['grey']['exumi_windows_per_s']['median']:,.0f} a second"


def _decoding(r: Results) -> str:
    grey = r["grey"]
    rate = grey["decoding_only_windows_per_s"]["simplejpeg"]["median"]
    return f"{rate:,.0f} a second (ratio {grey['ratio_to_decoding']:.2f})"


def _lerobot(r: Results) -> str:
    grey = r["grey"]
    ways, ratio = grey["lerobot"]["by_allocator"], grey["ratio_to_lerobot"]
    return (
        f"{ways['default']['windows_per_s']:.0f} a second as installed ({ratio['default']}×); "
        f"{ways['kept']['windows_per_s']:.0f} with a C library told to keep freed memory "
        f"({ratio['kept']}×)"
    )


def _floats(r: Results) -> str:
    grey = r["grey"]
    rate = grey["exumi_float32_chw_windows_per_s"]["median"]
    ratio = grey["ratio_to_lerobot_float32_chw"]["default"]
    return f"{rate:,.0f} a second ({ratio}× LeRobotDataset as installed)"


def _colour(r: Results) -> str:
    rgb = r["rgb"]
    ratio = rgb["ratio_to_lerobot"]
    return (
        f"{rgb['exumi_windows_per_s']['median']:,.0f} a second ({rgb['ratio_to_decoding']:.2f} of "
        f"decoding; {ratio['default']}× LeRobotDataset as installed, {ratio['kept']}× with a C "
        "library told to keep freed memory); as float32 CHW "
        f"{rgb['exumi_float32_chw_windows_per_s']['median']:,.0f} "
        f"({rgb['ratio_to_lerobot_float32_chw']['default']}×)"
    )


def _sampling(r: Results) -> str:
    some, every = r["exumi_0.9_5"], r["every_window_active"]

    def medians(case: Results) -> tuple[float, float]:
        rates = case["windows_per_s"]
        return rates["sampler"]["median"], rates["loop"]["median"]

    def pair(case: Results) -> str:
        ours, theirs = medians(case)
        return f"{ours:,.0f} against {theirs:,.0f}"

    def ratio(case: Results) -> str:
        ours, theirs = medians(case)
        return f"{ours / theirs:.1f}×"

    rates = some["windows_per_s"]
    by_processor = rates["sampler"]["per_cpu_s"] / rates["loop"]["per_cpu_s"]
    return (
        f"0.9 and 5 retries: {pair(some)} a second ({ratio(some)}; in processor time "
        f"{by_processor:.1f}×); every window active: {pair(every)} ({ratio(every)})"
    )


def _workers(r: Results) -> str:
    own = [value for run in r["worker_private_mib"] for value in run]
    handed = [value for run in r["worker_shared_mib"] for value in run]
    gain = r["gain_of_two"]
    return (
        f"{gain['loader']:.2f}×, and {gain['decoding']:.2f}× ({r['ratio']:.2f} of it); "
        f"{_span(own, '.0f')} MiB a worker of its own and {_span(handed, '.0f')} MiB that it "
        "hands batches over in, over four passes"
    )


def _scale_open(r: Results) -> str:
    peak = max(run["peak_mib"] for run in r["open"])
    return f"{_span([run['open_s'] for run in r['open']], '.1f')} s, {peak} MiB"


def _scale_batch(r: Results) -> str:
    def seconds(case: str, which: str) -> list[float]:
        return [run[which]["seconds"] for run in r[f"first_active_batch_{case}_s_episodes"]]

    cached = seconds("60", "cached") + seconds("5", "cached")
    return (
        f"episodes of a minute: {_span(seconds('60', 'cold'), '.1f')} s; of five seconds: "
        f"{_span(seconds('5', 'cold'), '.1f')} s; with the index cached {_span(cached, '.1f')} s"
    )


def _retrieval(r: Results) -> str:
    speed = r["speed"]
    return (
        f"one query {speed['batch_1']['ratio']:.2f}×, 64 queries {speed['batch_64']['ratio']:.2f}×;"
        f" opened in {speed['open_s_cold']:.2f} s"
    )


def _touch(r: Results) -> str:
    rate, bare = r["clips_per_s"]["loader"], r["clips_per_s"]["bare_decoding"]
    return f"{rate:,.0f} against {bare:,.0f} clips a second (ratio {r['loader_to_bare']:.2f})"


def _opening(r: Results) -> str:
    new = r["import_and_open_in_a_new_process_s"]["median"]
    return f"{1000 * r['open_s']['median']:.1f} ms ({new:.2f} s with the imports, in a new process)"


def _index(r: Results) -> str:
    cold, cached = r["window_index_cold_s"]["median"], r["window_index_cached_s"]["median"]
    return f"{cold:.2f} s / {1000 * cached:.1f} ms"


def _remote(r: Results) -> str:
    far, settings = r["remote"], r["settings"]
    return (
        f"{far['windows_per_s']:.0f} a second, {far['requests_per_window']:.2f} requests a window "
        f"({far['requests_per_window_with_opening']:.2f} with those of opening, which takes "
        f"{far['opening']['seconds']:.1f} s), {1000 * settings['latency_s']:.0f} ms each, "
        f"{settings['workers']} workers, {100 * far['cache']['share_of_set']:.1f} % of the set kept"
        f"; from the disk {r['local_windows_per_s']:,.0f} a second"
    )


# -------------------------------------------------------------------------- converting, validating


def _convert(r: Results) -> str:
    return f"{r['convert_frames_per_s']['median']:,} frames a second"


def _prepare(r: Results) -> str:
    colour, grey = r["prepare_frames_per_s"], r["prepare_gray_frames_per_s"]
    return f"{colour['median']:,} / {grey['median']:,} frames a second"


def _levels(r: Results) -> str:
    clips = r["bench-native"]
    names = ("document", "hierarchy", "arrays")
    rates = [f"{clips[f'{name}_episodes_per_s']['median']:.0f}" for name in names]
    return " / ".join(rates) + " episodes a second"


def _all_levels(r: Results, colour: Results) -> str:
    clips = r["bench-native"]
    return (
        f"clips of 3 to 5 s: 320×240 MPEG-4 video {clips['data_to_bare']:.2f} "
        f"({clips['data_to_codec']:.2f} of FFmpeg's decoder alone, no pixels taken out of it), "
        f"224×224 colour JPEG {colour['prepared-rgb']['data_to_bare']:.2f}, grey JPEG "
        f"{r['bench-prepared']['data_to_bare']:.2f}, 640×480 MJPEG "
        f"{colour['wedge']['data_to_bare']:.2f}"
    )


def _umi(r: Results) -> str:
    runs = list(r["buffers"].values())
    times = " and ".join(f"{run['times_the_loop']['median']:.2f}×" for run in runs)
    memory = " and ".join(str(run["peak_mib"]) for run in runs)
    sizes = " and ".join(f"{run['mib']:.0f}" for run in runs)
    listing = r["directory"]
    return (
        f"{times} its time, {memory} MiB of memory, for buffers of {sizes} MiB; the directory of a "
        f"zip of {listing['members']:,} members in {listing['seconds']:.1f} s, "
        f"{listing['bytes_a_member']} bytes a member"
    )


def _session(r: Results) -> str:
    parts = []
    for one in r["kept"]:
        two = one[f"{r['workers']}_workers"]
        text = (
            f"{one['session_s'] / 60:.1f} minutes and {one['mb'] / 1e3:.1f} GB: "
            f"{two['times_real_time']:.0f}× real time ({two['seconds']:.0f} s), "
            f"{two['peak_mb_of_largest_process']} MB at most"
        )
        if "1_workers" in one:
            text += f"; one worker {one['1_workers']['times_real_time']:.0f}×"
        parts.append(text)
    return "; ".join(parts) + ". The latency clip is decoded first, whatever the session's length"


def _decoded(r: Results) -> str:
    one, two = r["decoded_1_workers"], r["decoded_2_workers"]
    return (
        f"{two['frames']:,} frames: two workers {two['of_decode_only']:.2f}, one worker "
        f"{one['of_decode_only']:.2f}: each frame is encoded as JPEG, too"
    )


def _truth(r: Results) -> str:
    noisy = r["with_the_trackers_noise"]

    def said(name: str, unit: str) -> str:
        one = noisy[name]
        within, share = one["share_within"]
        return (
            f"{one['rms']:.2f} {unit} rms, {one['most']:.2f} at most "
            f"({100 * share:.2f} % within {within:g})"
        )

    return (
        f"poses {said('pose_mm', 'mm')} and {said('pose_deg', 'degrees')}, widths "
        f"{said('width_mm', 'mm')}; at the camera's frames, between two samples, poses "
        f"{said('pose_at_frames_mm', 'mm')} and {said('pose_at_frames_deg', 'degrees')}, widths "
        f"{said('width_at_frames_mm', 'mm')}; times of pictures {said('rgb_time_ms', 'ms')}, of "
        f"touch {said('tactile_time_ms', 'ms')}; {noisy['tactile_frames_not_the_hubs']} tactile "
        "frames are not the hub's own"
    )


def _ray(r: Results) -> str:
    overhead, seconds = r["overhead"], r["seconds"]
    local = seconds["local"]["convert"] + seconds["local"]["validate"]
    one, two = overhead["ray_one_node"], overhead["ray_two_nodes"]
    return (
        f"{r['episodes']:,} clips, {local:.0f} s locally: one node of two processors "
        f"{100 * one['both']:.0f} % longer, two nodes of one {100 * two['both']:.0f} %; starting "
        f"and ending a cluster takes {seconds['ray_one_node']['start']:.0f} + "
        f"{seconds['ray_one_node']['stop']:.0f} s besides"
    )


def _sync(r: Results) -> str:
    def of(name: str) -> str:
        return f"{r[name]['count']} of {r[name]['of']}"

    return (
        f"the 95 % interval of the latency holds the truth for {of('interval_covers')} streams, "
        f"{of('found_20_ms')} faults of 20 ms are found, {of('false_alarms')} streams in step are "
        "called late"
    )


# --------------------------------------------------------------------------------------- recording


def _recording(r: Results) -> str:
    share, size = 100 * r["share_of_one_core"], r["written_mb"] / 1000
    return (
        f"{r['dropped']} drops, {r['missing']} samples missing, {share:.0f} % of one core, "
        f"{r['peak_rss_mib']} MiB ({size:.1f} GB written, while other jobs held the machine's load "
        f"at {r['machine']['load_before']:.0f})"
    )


def _ages(alone: Results, minute: Results, loaded: Results) -> str:
    def of(age: Results) -> str:
        return f"median {age['median']:.2f} ms, 99 % {age['p99']:.2f} ms, most {age['most']:.1f} ms"

    age = alone["age_ms"] | {"most": alone["age_ms"]["largest"]}
    return (
        f"alone: {of(age)}; with the streams above, for a minute: {of(minute['pose_age_ms'])}; in "
        f"the ten minutes above: {of(loaded['pose_age_ms'])}"
    )


def _lost(case: Results) -> str:
    most = max(stream["most_ms"] for stream in case["lost"].values())
    return f"{case['valid']} valid episodes, at most {most:.0f} ms of a stream lost"


def _lost_under_load(r: Results) -> str:
    return (
        f"kills: {_lost(r['kill'])}; power losses: {_lost(r['power_loss'])} "
        f"(load {r['machine']['load_before']:.0f} at the start)"
    )


def _finalise(r: Results) -> str:
    made, copied = r["finalise_mb_per_s"]["median"], r["copy_sha256_fsync_mb_per_s"]["median"]
    return f"{made:.0f} against {copied:.0f} MB/s ({r['ratio']:.2f})"


def _sweep(r: Results) -> str:
    bare, real = r["without_effects"], r["with_effects"]["all"]
    sweeps = bare["all"]["sweeps"] + real["sweeps"]
    wrong = bare["all"]["wrong_basins"] + real["wrong_basins"]
    accepted = sum(map(len, r["wrong_data_accepted"].values()))
    tried = r["wrong_data_of_each_kind"] * len(r["wrong_data_accepted"])
    bias = max(abs(case["bias_ms"]) for case in bare.values())
    return (
        f"RMS {bare['0.3 Hz']['rms_ms']:.2f} ms at 0.3 Hz, {bare['2 Hz']['rms_ms']:.2f} ms at "
        f"2 Hz, bias at most {bias:.3f} ms; with readout, exposure and the headset's lag RMS "
        f"{real['rms_ms']:.1f} ms, stated sigma {real['stated_sigma_ms']:.1f} ms; {wrong} wrong "
        f"basins in {sweeps:,}; {accepted} of {tried} wrong recordings accepted"
    )


def _attach(r: Results) -> str:
    got = r["results"]
    return (
        f"{got['attached']} of {got['belonging']}: RMS {got['rms_ms']:.1f} ms, worst "
        f"{got['worst_ms']:.1f} ms; {got['foreign_attached']} foreign clips placed"
    )


def _drivers(r: Results) -> str:
    return (
        f"encoder at 500 Hz {r['as5600_500']['percent_of_a_core']} %, taxels at 1 kHz "
        f"{r['tac02_1000']['percent_of_a_core']} %"
    )


# -------------------------------------------------------------------------------------- publishing


def _release(r: Results) -> str:
    first = r["first"]
    same = "byte-identical" if r["identical"] else "NOT the same"
    return (
        f"{first['all_s']:.0f} s, of which validating {first['validate_s']:.0f} s; released again "
        f"by one process: {same}; preview {r['preview_bytes'] / 1e6:.1f} MB"
    )


def _verify(r: Results) -> str:
    found = r["damages"]
    return (
        f"{r['verify_s']:.1f} s ({r['verify_quick_s']:.1f} s with `--quick`); a flipped bit is "
        f"found {found['changed']}, a missing file {found['missing']}, an extra one "
        f"{found['extra']} times"
    )


def _page(r: Results) -> str:
    clips = r["bench-native"]
    return (
        f"{clips['beyond_reading_s']:.1f} s beyond reading, {clips['bytes'] / 1e6:.2f} MB, "
        f"{clips['peak_mib']} MiB of memory"
    )


TABLES: dict[str, tuple[Row, ...]] = {
    "loading": (
        Row(
            "windows of 8 grey tactile frames + 1 RGB frame + 32 actions, 224×224, one core",
            ("windows",),
            _windows,
        ),
        Row("the same JPEGs, only decoded in a loop", ("windows",), _decoding),
        Row("LeRobotDataset 0.4.4, same frames, one core, same run", ("windows",), _lerobot),
        Row("the same windows as float32 CHW (`ToFloat`)", ("windows",), _floats),
        Row("windows with RGB tactile frames", ("windows",), _colour),
        Row(
            "windows where a tenth is active, `ActiveWindowSampler` against decoding, rejecting "
            "and drawing again",
            ("sampling",),
            _sampling,
        ),
        Row(
            "a second worker, and a second process that only decodes",
            ("workers",),
            _workers,
        ),
        Row(
            "opening 100,000 episodes (a synthetic catalog), in a new process",
            ("scale",),
            _scale_open,
        ),
        Row(
            "first active batch of 480,000 frames, in a new process, no index cached",
            ("scale",),
            _scale_batch,
        ),
        Row(
            "top 5 of 1,000,000 vectors of 1,024 float32, mapped from disk, against the bare "
            "matrix product in memory",
            ("retrieval",),
            _retrieval,
        ),
        Row(
            "contrastive batches of touch clips, 10 salient frames each, against decoding alone",
            ("touch",),
            _touch,
        ),
        Row(
            "windows from an S3 server on localhost that takes its time, cold",
            ("remote",),
            _remote,
        ),
        Row("opening a dataset of 264 episodes from its catalog", ("opening",), _opening),
        Row("the window index of 264 episodes, cold / cached", ("opening",), _index),
    ),
    "converting": (
        Row(
            "`exumi convert`, 264 Octopi clips, 29,764 frames, two cores",
            ("convert",),
            _convert,
        ),
        Row("`exumi prepare`, colour / `--gray`, two cores", ("convert",), _prepare),
        Row(
            "UMI replay buffers (`.zarr.zip`, JPEG XL and three tactile channels a row), against "
            "a loop that only decodes and encodes their images",
            ("convert_umi",),
            _umi,
        ),
        Row(
            "a raw exUMI session, videos kept, two workers",
            ("convert_session",),
            _session,
        ),
        Row(
            "a session with `--decode`, against one process that only decodes",
            ("convert_session",),
            _decoded,
        ),
        Row(
            "simulated sessions (poses at 30 a second, with a tracker's noise) against their truth",
            ("session_truth",),
            _truth,
        ),
    ),
    "cluster": (
        Row(
            "converting and validating with `--engine ray` on this machine of two cores, against "
            "two processes",
            ("ray_engine",),
            _ray,
        ),
    ),
    "publishing": (
        Row("`exumi release`, 264 Octopi clips, two cores", ("release",), _release),
        Row("`exumi release verify` of it", ("release",), _verify),
        Row("`exumi stats --html`, 264 Octopi clips, two cores", ("stats_html",), _page),
    ),
    "validating": (
        Row(
            "`exumi_validators.validate`, 264 Octopi clips, two cores: levels up to document / "
            "hierarchy / arrays",
            ("validate",),
            _levels,
        ),
        Row(
            "all levels, against a loop that only decodes the same frames to the pixels that are "
            "declared, in as many processes",
            ("validate", "validate_colour"),
            _all_levels,
        ),
        Row(
            "latency of tactile streams of 200 simulated episodes",
            ("sync_check",),
            _sync,
        ),
    ),
    "recording": (
        Row(
            "two 640×480 MJPEG cameras at 30/s, one 1080p at 60/s, pose 90 Hz, encoder 500 Hz, "
            "taxels 1 kHz: ten minutes",
            ("recording",),
            _recording,
        ),
        Row(
            "age of a pose when it is stored, from the kernel's stamp",
            ("pose_age", "recording_60_s", "recording"),
            _ages,
        ),
        Row(
            "200 kills (SIGKILL) at random moments",
            ("crash_safety",),
            lambda r: _lost(r["kill"]),
        ),
        Row(
            "200 power losses: what was not flushed is gone",
            ("crash_safety",),
            lambda r: _lost(r["power_loss"]),
        ),
        Row(
            "the same kills and power losses on a busy machine",
            ("crash_safety_loaded",),
            _lost_under_load,
        ),
        Row(
            "making an episode of a journal, against copy + SHA-256 + `fsync` of the same 1.0 GB",
            ("finalise",),
            _finalise,
        ),
        Row(
            "latency by a sweep, 0.3 to 2 Hz, true delay within ±300 ms, 15 % of the frames "
            "missing",
            ("latency_sweep",),
            _sweep,
        ),
        Row(
            "clips placed in 8 sessions of 50, clocks up to a minute off",
            ("attach",),
            _attach,
        ),
        Row("drivers' part of one core", ("drivers",), _drivers),
    ),
}


# ------------------------------------------------------------------------------------------- texts


def _parts_of_a_window(r: Results) -> str:
    grey = r["grey"]
    window = 1e3 / grey["exumi_windows_per_s"]["median"]
    whole = 1e3 / grey["exumi_float32_chw_windows_per_s"]["median"]
    decoding = 1e3 / grey["decoding_only_windows_per_s"]["simplejpeg"]["median"]
    floats = whole - window
    peer = grey["lerobot"]["by_allocator"]["default"]["windows_per_s"]
    least = 1e3 / (decoding + floats)
    return fill(
        f"As floats on the CPU there is little left to gain: of the {whole:.2f} ms that a window "
        f"takes, {decoding:.2f} are decoding (the loop above), {floats:.2f} are floats (dividing "
        f"and writing 2.4 MB), and {window - decoding:.2f} are reading the files, their checksums, "
        "poses and widths. With nothing but the decoding and the floats it would be "
        f"{least / peer:.1f}× LeRobotDataset.",
        width=110,
    )


def _sweeps_by_rate(r: Results) -> str:
    lines = [
        "| sweeps at | bias | RMS | largest | stated "
        "| with effects: bias | RMS | largest | stated |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for rate, bare in r["without_effects"].items():
        real = r["with_effects"][rate]
        names = ("rms_ms", "largest_ms", "stated_sigma_ms")
        cells = [rate, f"{bare['bias_ms']:+.3f}", *(f"{bare[name]:.3f}" for name in names)]
        cells += [f"{real['bias_ms']:+.2f}", *(f"{real[name]:.2f}" for name in names)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _sweeps_in_words(r: Results) -> str:
    bare, real = r["without_effects"]["all"], r["with_effects"]["all"]
    wrong = r["wrong_data_accepted"]
    ways = (r["without_effects"], r["with_effects"])
    slow = [rate for rate in ways[0] if rate != "all" and any(way[rate]["refused"] for way in ways)]
    where = f", all at {' and '.join(slow)}" if slow else ""
    return fill(
        f"Milliseconds; {bare['sweeps']:,} sweeps without effects and {real['sweeps']:,} with "
        "them. *With effects*, exposure, readout and lag are drawn from their ranges and not known "
        "to the estimate, and the error is against the latency that the poses had in the sweep; "
        "*stated* also covers that they have another lag in use "
        f"({100 * real['within_2_sigma_in_use']:.0f} % within two standard deviations then). "
        f"{bare['wrong_basins'] + real['wrong_basins']} of the accepted sweeps were in a "
        "wrong basin. "
        f"{bare['refused'] + real['refused']} of {bare['sweeps'] + real['sweeps']:,} were "
        f"refused{where}. "
        f"Without effects, {100 * bare['within_2_sigma_in_sweep']:.0f} % of the errors lie within "
        f"two standard deviations. Of {len(wrong)} kinds of wrong data (no motion, frozen "
        "tracking, periodic sweeps, unrelated motion, few detections, another time, a clock that "
        f"steps, a delay beyond the range), {r['wrong_data_of_each_kind']} each, "
        f"{sum(map(len, wrong.values()))} were accepted.",
        width=110,
    )


TEXTS: dict[str, Text] = {
    "parts_of_a_window": Text("windows", _parts_of_a_window),
    "sweeps_by_rate": Text("latency_sweep", _sweeps_by_rate),
    "sweeps_in_words": Text("latency_sweep", _sweeps_in_words),
}
