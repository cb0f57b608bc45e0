#!/usr/bin/env python3
"""Makes the files in this folder: one small scene in the formats of other programs.

Each is written by the format's own or an independent package, so that reading them proves more
than agreement with ourselves:

    realsense*.bag        rosbags (ROS 1 writer), topics as RealSense's SDK names them
    ros2*.mcap            mcap-ros2-support and mcap (the container's own Python library)
    rvl.mcap              the same; RVL itself written here, as no package writes it
    kinect.mkv            PyAV (FFmpeg's Matroska writer)
    kinect-remuxed.mkv    the same through mkvmerge, with a tag of Azure Kinect
    scannet.sens          written here with struct and zlib: no independent writer exists
    seven_scenes/         Pillow

    python3 -m venv venv
    venv/bin/pip install numpy pillow av rosbags mcap mcap-ros2-support lz4 zstandard
    apt-get install mkvtoolnix
    venv/bin/python tests/foreign/make.py

The scene is simple enough to be made again by the tests that read the files: see `scene`.
"""
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import av
import numpy as np
from PIL import Image

HERE = Path(__file__).resolve().parent
WIDTH, HEIGHT, FRAMES = 32, 24, 3
FX, FY, CX, CY = 28.5, 28.25, 15.75, 11.5
PERIOD_NS = 33_333_333
START_NS = 1_700_000_000_250_000_000


def scene(k, hole=0):
    """A slope with a hole and a step that moves by a pixel a frame; millimetres."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    depth = 900 + 7 * x + 11 * y + 3 * k
    depth[(x >= 8 + k) & (x < 16 + k) & (y >= 6) & (y < 18)] = 650 + k
    depth[(x - 25) ** 2 + (y - 5) ** 2 < 9] = hole
    return depth.astype(np.uint16)


def stamp(k):
    return START_NS + k * PERIOD_NS


def metres(k):
    depth = scene(k).astype(np.float32) / np.float32(1000)
    depth[depth == 0] = np.nan
    return depth


# --- ROS 1 ------------------------------------------------------------------------------------

def realsense_bag(path, compression):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    Header, Time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    ImageMsg, Info = types["sensor_msgs/msg/Image"], types["sensor_msgs/msg/CameraInfo"]
    Roi, Float = types["sensor_msgs/msg/RegionOfInterest"], types["std_msgs/msg/Float32"]
    path.unlink(missing_ok=True)
    writer = Writer(path)
    if compression:
        writer.set_compression(getattr(Writer.CompressionFormat, compression))
    with writer:
        sensor = "/device_0/sensor_0"
        info = writer.add_connection(f"{sensor}/Depth_0/info/camera_info", Info.__msgtype__, typestore=store)
        unit = writer.add_connection(f"{sensor}/option/Depth_Units/value", Float.__msgtype__, typestore=store)
        infrared = writer.add_connection(f"{sensor}/Infrared_1/image/data", ImageMsg.__msgtype__, typestore=store)
        depth = writer.add_connection(f"{sensor}/Depth_0/image/data", ImageMsg.__msgtype__, typestore=store)
        k = np.array([FX, 0, CX, 0, FY, CY, 0, 0, 1])
        header = lambda seq, ns: Header(seq, Time(ns // 10**9, ns % 10**9), "0")
        raw = lambda message: store.serialize_ros1(message, message.__msgtype__)
        writer.write(info, 1, raw(Info(
            header(0, 0), HEIGHT, WIDTH, "Brown Conrady", np.zeros(5), k, np.eye(3).ravel(),
            np.zeros(12), 0, 0, Roi(0, 0, 0, 0, False))))
        writer.write(unit, 1, raw(Float(np.float32(0.001))))
        for n in range(FRAMES):
            ns = stamp(n)
            grey = (scene(n) % 256).astype(np.uint8)
            writer.write(infrared, ns, raw(ImageMsg(
                header(n, ns), HEIGHT, WIDTH, "mono8", 0, WIDTH, grey.ravel())))
            # frame numbers begin at 41; the sensor lost one after the second frame
            seq = 41 + n + (n > 1)
            writer.write(depth, ns, raw(ImageMsg(
                header(seq, ns), HEIGHT, WIDTH, "mono16", 0, 2 * WIDTH,
                scene(n).view(np.uint8).ravel())))


# --- ROS 2 ------------------------------------------------------------------------------------

HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
IMAGE = """std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
""" + HEADER
COMPRESSED = "std_msgs/Header header\nstring format\nuint8[] data\n" + HEADER
INFO = """std_msgs/Header header
uint32 height
uint32 width
string distortion_model
float64[] d
float64[9] k
float64[9] r
float64[12] p
uint32 binning_x
uint32 binning_y
sensor_msgs/RegionOfInterest roi
================================================================================
MSG: sensor_msgs/RegionOfInterest
uint32 x_offset
uint32 y_offset
uint32 height
uint32 width
bool do_rectify
""" + HEADER


def ros2(path, compression, images):
    """`images(n)` gives (topic, schema name, message) for frame n."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file, compression=getattr(CompressionType, compression))
        schemas = {
            "image": writer.register_msgdef("sensor_msgs/msg/Image", IMAGE),
            "compressed": writer.register_msgdef("sensor_msgs/msg/CompressedImage", COMPRESSED),
            "info": writer.register_msgdef("sensor_msgs/msg/CameraInfo", INFO),
        }
        for n in range(FRAMES):
            ns = stamp(n)
            header = {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": "depth"}
            for topic, schema, message in images(n):
                message = {"header": header, **message}
                writer.write_message(topic, schemas[schema], message, ns, ns)
        writer.finish()


def info(distortion=()):
    return {
        "height": HEIGHT, "width": WIDTH, "distortion_model": "plumb_bob", "d": list(distortion),
        "k": [FX, 0, CX, 0, FY, CY, 0, 0, 1], "r": list(np.eye(3).ravel()), "p": [0.0] * 12,
        "binning_x": 0, "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }


def colour_info():
    wrong = info()
    wrong["k"] = [99.0, 0, 1, 0, 99.0, 1, 0, 0, 1]
    return wrong


def integers(n, big_endian=False, padding=0):
    depth = scene(n).astype(">u2" if big_endian else "<u2")
    rows = [row.tobytes() + bytes(padding) for row in depth]
    return {"height": HEIGHT, "width": WIDTH, "encoding": "16UC1", "is_bigendian": int(big_endian),
            "step": 2 * WIDTH + padding, "data": b"".join(rows)}


def floats(n):
    return {"height": HEIGHT, "width": WIDTH, "encoding": "32FC1", "is_bigendian": 0,
            "step": 4 * WIDTH, "data": metres(n).astype("<f4").tobytes()}


def png(array):
    import io
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, format="PNG")
    return buffer.getvalue()


def rvl(depth):
    """RVL as ROS's compressed_depth_image_transport has it, written after Wilson's paper."""
    nibbles = []

    def put(value):
        while True:
            low, value = value & 7, value >> 3
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    values, at, last = depth.ravel().tolist(), 0, 0
    while at < len(values):
        zeros = at
        while zeros < len(values) and values[zeros] == 0:
            zeros += 1
        end = zeros
        while end < len(values) and values[end] != 0:
            end += 1
        put(zeros - at)
        put(end - zeros)
        for value in values[zeros:end]:
            delta = value - last
            put((delta << 1) ^ (delta >> 31) if delta >= 0 else (-delta << 1) - 1)
            last = value
        at = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [int("".join(f"{n:x}" for n in nibbles[i:i + 8]), 16) for i in range(0, len(nibbles), 8)]
    return struct.pack(f"<{len(words)}I", *words)


def compressed(n, how):
    header = struct.pack("<iff", 0, 0.0, 0.0)
    data = png(scene(n)) if how == "png" else struct.pack("<II", WIDTH, HEIGHT) + rvl(scene(n))
    return {"format": f"16UC1; compressedDepth {how}", "data": header + data}


def inverse(n):
    """32FC1 as compressedDepth quantises it: a / z + b, 0 for no measurement."""
    quantum, far = 100.0, 10.0
    a = quantum * (quantum + 1.0)
    b = 1.0 - a / far
    z = metres(n)
    q = np.where(np.isfinite(z), a / np.where(np.isfinite(z), z, 1) + b, 0)
    header = struct.pack("<iff", 0, a, b)
    return {"format": "32FC1; compressedDepth png", "data": header + png(q.astype(np.uint16))}


# --- Azure Kinect -----------------------------------------------------------------------------

CALIBRATION = json.dumps({"CalibrationInformation": {"Cameras": [{
    "Intrinsics": {"ModelParameters": [0.5, 0.503, 0.4925, 0.4926, 0.55, -0.02, 0, 0.89, 0.086, -0.014, 0, 0, 0, 0]},
    "Location": "CALIBRATION_CameraLocationD0"}]}}).encode() + b"\0"


def video(path, frames, size):
    """As Azure Kinect has it: codec V_MS/VFW/FOURCC, format b16g."""
    with av.open(str(path), "w", options={"allow_raw_vfw": "1"}) as out:
        stream = out.add_stream("rawvideo", rate=30)
        stream.width, stream.height = size
        stream.pix_fmt = "gray16be"
        stream.codec_context.codec_tag = "b16g"
        stream.metadata["title"] = "DEPTH"
        out.add_attachment("calibration.json", "application/octet-stream", CALIBRATION)
        for n, depth in enumerate(frames):
            frame = av.VideoFrame(*size, "gray16be")
            plane = frame.planes[0]
            rows = np.zeros((size[1], plane.line_size // 2), np.uint16)
            rows[:, :size[0]] = depth.byteswap()
            plane.update(rows.tobytes())
            frame.pts = n
            for packet in stream.encode(frame):
                out.mux(packet)
        for packet in stream.encode():
            out.mux(packet)
    # FFmpeg clears the FourCC of raw video in the BITMAPINFOHEADER; it reads the files that have it
    data = path.read_bytes()
    at = data.index(struct.pack("<Ii", 40, size[0])) + 16
    path.write_bytes(data[:at] + b"b16g" + data[at + 4:])
    check_video(path, frames)


def check_video(path, frames):
    """FFmpeg decodes what was meant."""
    with av.open(str(path)) as file:
        assert file.streams.video[0].codec_context.codec_tag == "b16g"
        decoded = [frame.to_ndarray() for frame in file.decode(video=0)]
    assert len(decoded) == len(frames)
    assert all((a.astype(np.uint16) == b).all() for a, b in zip(decoded, frames))


def kinect(folder):
    frames = [scene(n) for n in range(FRAMES)]
    video(folder / "kinect.mkv", frames, (WIDTH, HEIGHT))
    with tempfile.TemporaryDirectory() as scratch:
        scratch = Path(scratch)
        (scratch / "tags.xml").write_text(
            "<Tags><Tag><Simple><Name>K4A_START_OFFSET_NS</Name><String>200011000</String></Simple></Tag></Tags>")
        subprocess.run([
            "mkvmerge", "-q", "-o", folder / "kinect-remuxed.mkv",
            "--global-tags", scratch / "tags.xml", folder / "kinect.mkv"], check=True)
    check_video(folder / "kinect-remuxed.mkv", frames)


# --- ScanNet, 7-Scenes ------------------------------------------------------------------------

def scannet(path):
    matrix = lambda fx, fy, cx, cy: np.array(
        [[fx, 0, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float32).tobytes()
    name, eye = b"StructureSensor", np.eye(4, dtype=np.float32).tobytes()
    with open(path, "wb") as out:
        out.write(struct.pack("<IQ", 4, len(name)) + name)
        out.write(matrix(99, 99, 1, 1) + eye + matrix(FX, FY, CX, CY) + eye)
        out.write(struct.pack("<iiIIIIfQ", 2, 1, 4, 3, WIDTH, HEIGHT, 1000.0, FRAMES))
        for n in range(FRAMES):
            colour, depth = b"\xff\xd8\xff\xd9", zlib.compress(scene(n).tobytes())
            us = 5_000_000 + n * 33_333
            out.write(eye + struct.pack("<QQQQ", us + 7, us, len(colour), len(depth)) + colour + depth)
        out.write(struct.pack("<Q", 0))  # no motion samples


def seven_scenes(folder):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for n in range(FRAMES):
        name = folder / f"frame-{n:06}"
        Image.fromarray(scene(n, hole=65535)).save(f"{name}.depth.png")
        Image.fromarray(np.zeros((3, 4, 3), np.uint8)).save(f"{name}.color.png")
        Path(f"{name}.pose.txt").write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")


def main():
    for name, compression in [("realsense", None), ("realsense-lz4", "LZ4"), ("realsense-bz2", "BZ2")]:
        realsense_bag(HERE / f"{name}.bag", compression)
    ros2(HERE / "ros2-zstd.mcap", "ZSTD", lambda n: [
        ("/camera/color/camera_info", "info", colour_info()),
        ("/camera/depth/image_rect_raw", "image", integers(n)),
        ("/camera/depth/camera_info", "info", info()),
    ])
    ros2(HERE / "ros2-lz4-big-endian.mcap", "LZ4", lambda n: [
        ("/depth/camera_info", "info", info()),
        ("/depth/image", "image", integers(n, big_endian=True, padding=6)),
    ])
    ros2(HERE / "ros2-float.mcap", "NONE", lambda n: [
        ("/depth/image", "image", floats(n)), ("/depth/camera_info", "info", info([0.1]))])
    ros2(HERE / "ros2-png.mcap", "ZSTD", lambda n: [
        ("/depth/camera_info", "info", info()),
        ("/depth/image/compressedDepth", "compressed", compressed(n, "png"))])
    ros2(HERE / "ros2-rvl.mcap", "NONE", lambda n: [
        ("/depth/camera_info", "info", info()),
        ("/depth/image/compressedDepth", "compressed", compressed(n, "rvl"))])
    ros2(HERE / "ros2-inverse.mcap", "NONE", lambda n: [
        ("/depth/camera_info", "info", info()),
        ("/depth/image/compressedDepth", "compressed", inverse(n))])
    ros2(HERE / "ros2-two-topics.mcap", "ZSTD", lambda n: [
        ("/camera/aligned_depth_to_color/camera_info", "info", colour_info()),
        ("/camera/aligned_depth_to_color/image_raw", "image", integers(0)),
        ("/camera/depth/camera_info", "info", info()),
        ("/camera/depth/image_rect_raw", "image", integers(n)),
    ])
    kinect(HERE)
    scannet(HERE / "scannet.sens")
    seven_scenes(HERE / "seven_scenes")
    if len(sys.argv) > 1:
        # a real depth mode, whose calibration is understood; too large to keep
        size = (320, 288)
        depth = np.fromfunction(lambda y, x: 500 + x + 2 * y, size[::-1]).astype(np.uint16)
        video(Path(sys.argv[1]) / "kinect-320x288.mkv", [depth, depth + 1], size)
    for path in sorted(HERE.rglob("*")):
        if path.is_file():
            print(f"{os.path.getsize(path):8} {path.relative_to(HERE)}")


if __name__ == "__main__":
    main()
