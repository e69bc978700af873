"""``python -m sim_backend.ptpip``: an emulated camera for other people's programs to talk to."""

import argparse
import sys
from pathlib import Path

from drivers.errors import DeviceError
from sim_backend.ptpip.process import BODIES, MODELS
from sim_backend.ptpip.responder import Responder
from sim_backend.ptpip.sources import drawn_photos, photos_of_folder

STANDARD_PORT = 15740


def main() -> int:
    """Serve until Ctrl-C."""
    parser = argparse.ArgumentParser(
        prog="python -m sim_backend.ptpip", description="Emulate a camera on PTP/IP, on 127.0.0.1."
    )
    parser.add_argument("--model", choices=MODELS, default="generic", help="which camera  [default: generic]")
    parser.add_argument(
        "--port", type=int, default=STANDARD_PORT, help=f"TCP port, 0 for a free one  [default: {STANDARD_PORT}]"
    )
    parser.add_argument(
        "--folder", type=Path, help="photograph the JPEG files of this folder in turn, instead of drawn ones"
    )
    parser.add_argument("--exposure-s", type=float, default=0.25, help="how long the shutter is open  [default: 0.25]")
    parser.add_argument(
        "--download-s", type=float, default=0.0, help="how long it then takes to the file  [default: 0]"
    )
    given = parser.parse_args()
    try:
        photographs = photos_of_folder(given.folder) if given.folder else drawn_photos()
        body = BODIES[given.model](photographs, exposure_s=given.exposure_s, download_s=given.download_s)
        responder = Responder(body, port=given.port)
    except (DeviceError, OSError) as error:
        sys.stderr.write(f"emulated camera: {error}\n")
        return 1
    port = responder.port
    sys.stdout.write(f"gphoto2 --port ptpip:127.0.0.1:{port}:{port} --camera 'PTP/IP Camera' --summary\n")
    sys.stdout.flush()
    try:
        responder.serve()
    except KeyboardInterrupt:
        responder.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
