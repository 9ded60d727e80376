#!/usr/bin/python3
"""Fits the shadow maps of one frame that is given by files, by a shadowfit service.

Does over the wire what `shadowfit optimize` does, and takes the same flags. Shows how little a script needs: the Python
modules generated from proto/ (the build puts them into build/<preset>/proto/python), grpc, numpy and OpenImageIO
(Debian: python3-grpcio python3-numpy python3-openimageio).
"""

import argparse
import json
import pathlib
import sys


def find_modules():
    """Puts the generated modules on the path, unless PYTHONPATH has them already."""
    root = pathlib.Path(__file__).resolve().parents[2]
    sys.path.extend(str(path) for path in sorted(root.glob("build/*/proto/python")))


find_modules()

import grpc
import OpenImageIO as oiio
from google.protobuf import json_format

from shadowfit.v1 import frame_pb2, optimizer_pb2, optimizer_pb2_grpc


def read_channel(path, sample_type, buffer):
    """Reads the only channel of a picture as the type that it has in the file, top row first."""
    image = oiio.ImageInput.open(path)
    if image is None:
        raise SystemExit(f"{path}: {oiio.geterror()}")
    spec = image.spec()
    if spec.nchannels != 1 or spec.format.basetype != sample_type:
        raise SystemExit(f"{path}: one channel of {oiio.TypeDesc(sample_type)} expected, "
                         f"{spec.nchannels} of {spec.format} found")
    pixels = image.read_image(0, 0, 0, 1, oiio.TypeDesc(sample_type))
    if pixels is None:
        raise SystemExit(f"{path}: {image.geterror()}")
    buffer.width = spec.width
    buffer.height = spec.height
    buffer.row_order = frame_pb2.ROW_ORDER_TOP_FIRST
    buffer.data = pixels.astype("<" + pixels.dtype.str[1:], copy=False).tobytes()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frame", required=True, help="shadowfit.v1.Frame as Protobuf JSON, without its buffers")
    parser.add_argument("--depth", required=True, help="EXR, one float channel: window depth")
    parser.add_argument("--bits", help="EXR, one uint32 channel: bit i belongs to light i")
    parser.add_argument("--method", help="normal, focused, ..., paper, default")
    parser.add_argument("--depth-format", choices=["unorm16", "unorm24", "float32"], default="unorm24",
                        help="of the shadow maps, for the safe bias")
    parser.add_argument("--budget", type=int, metavar="TEXELS", help="share so many texels among the lights")
    parser.add_argument("--atlas", metavar="WxH", help="lay the maps out in one texture")
    parser.add_argument("--tolerance", type=float, metavar="PIXELS", help="the smallest maps for so many wrong pixels")
    parser.add_argument("--rounding", choices=["exact", "8", "power_of_two"], default="exact",
                        help="of the sides of maps that are sized")
    parser.add_argument("--out", help="write shadowfit.v1.FrameResult as Protobuf JSON")
    parser.add_argument("--server", required=True, help="HOST:PORT or unix:PATH")
    parser.add_argument("--timeout", type=float, default=30.0, help="give up after so many seconds")
    parser.add_argument("--json", action="store_true", help="print the result as JSON instead of a table")
    arguments = parser.parse_args()

    request = optimizer_pb2.OptimizeRequest()
    with open(arguments.frame, encoding="utf-8") as file:
        json_format.Parse(file.read(), request.frame)
    read_channel(arguments.depth, oiio.FLOAT, request.frame.depth)
    if arguments.bits:
        read_channel(arguments.bits, oiio.UINT32, request.frame.shadow_bits)
    if arguments.method:
        request.frame.options.method = frame_pb2.Method.Value("METHOD_" + arguments.method.upper())

    safe_bias = request.frame.options.safe_bias
    safe_bias.format = frame_pb2.ShadowMapFormat.Value("SHADOW_MAP_FORMAT_" + arguments.depth_format.upper())

    options = request.frame.options
    options.assess_quality = True
    if arguments.budget:
        options.texel_budget.total_texels = arguments.budget
    if arguments.atlas:
        width, height = (int(side) for side in arguments.atlas.split("x"))
        options.texel_budget.atlas.width, options.texel_budget.atlas.height = width, height
    if arguments.tolerance:
        options.tolerance.max_misclassified_pixels = arguments.tolerance
    sizing = options.WhichOneof("map_sizing")
    if sizing:
        rounding = {"8": "MULTIPLE_OF_8"}.get(arguments.rounding, arguments.rounding.upper())
        getattr(options, sizing).sides.rounding = frame_pb2.SizeRounding.Value("SIZE_ROUNDING_" + rounding)

    unlimited = [("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1)]
    with grpc.insecure_channel(arguments.server, options=unlimited) as channel:
        stub = optimizer_pb2_grpc.OptimizerServiceStub(channel)
        try:
            result = stub.Optimize(request, timeout=arguments.timeout).result
        except grpc.RpcError as error:
            raise SystemExit(f"{error.code().name}: {arguments.server}: {error.details()}") from None

    document = json_format.MessageToDict(result, including_default_value_fields=True)
    if arguments.out:
        pathlib.Path(arguments.out).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    if arguments.json:
        print(json.dumps(document, indent=1))
    else:
        print(f"{'light':>10}  {'map':>11}  {'wrong pixels':>12}  {'ms':>8}  {'bias':>10}  {'slope':>8}  "
              f"{'worst':<11}  outcome")
        for light in result.lights:
            size = f"{light.shadow_map.width}x{light.shadow_map.height}"
            outcome = frame_pb2.FitOutcome.Name(light.outcome).removeprefix("FIT_OUTCOME_").lower().replace("_", " ")
            worst = frame_pb2.MapFlaw.Name(light.quality.worst).removeprefix("MAP_FLAW_").lower()
            print(f"{light.id:>10}  {size:>11}  {light.predicted_misclassified_pixels:>12.1f}  "
                  f"{light.optimize_seconds * 1e3:>8.3f}  {light.safe_bias.constant:>10.3e}  "
                  f"{light.safe_bias.slope:>8.5f}  {worst:<11}  {outcome}")


if __name__ == "__main__":
    main()
