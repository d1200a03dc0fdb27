"""Opens media with FFmpeg, restricted to chosen files, formats and protocols; passes on FFmpeg's messages.

A film may itself be a list of other media (HLS, ffconcat, SDP), under any name. FFmpeg would open everything on such a
list: other files, pipes, addresses. FORMATS omits the formats of lists.
"""

from collections.abc import Mapping
from pathlib import Path

import av
from av.codec.hwaccel import HWAccel
from av.container import InputContainer

from counterlight.errors import InputError
from counterlight.files.reading import not_read
from counterlight.media.medium import LiveAddress, Medium

HEIF = b"heic", b"heix", b"heim", b"heis", b"mif1"  # brands of a file with a picture
OPEN_S, READ_S = 10.0, 5.0  # FFmpeg's time limits for networks
_PICTURES = "image2"  # FFmpeg recognises it by suffix; for a name `*.y` it also opens `*.u` and `*.v`
_STREAMS = "rtsp,rtp"
# Demuxers whose pictures are all in one file or stream.
FORMATS = (
    "4xm,anm,apng,apv,asf,asf_o,av1,avi,avs,avs2,avs3,bethsoftvid,bfi,bink,bmv,c93,cavsvideo,cdg,"
    "cdxl,cine,dfa,dhav,dirac,dnxhd,dsicin,dv,dxa,ea,ea_cdata,evc,film_cpk,filmstrip,fits,flic,flv,"
    "frm,gdv,gif,gxf,h261,h263,h264,hevc,hnm,hxvs,ico,idcin,iff,ifv,ingenient,ipmovie,ipu,iv8,ivf,"
    "ivr,jpegxl_anim,jv,kux,live_flv,lmlm4,luodat,lvf,lxf,m4v,matroska,mgsts,mjpeg,mjpeg_2000,mm,mods,"
    "moflex,mov,mpeg,mpegts,mpegvideo,mpjpeg,msnwctcp,msp,mtv,mv,mvi,mxf,mxg,nc,nsv,nut,nuv,obu,"
    "ogg,paf,pdv,pmp,psxstr,pva,r3d,rawvideo,rl2,rm,roq,rpl,sdr2,ser,sga,siff,simbiosis_imx,smjpeg,"
    "smk,smush,swf,thp,tiertexseq,tmv,txd,ty,usm,v210,v210x,vc1,vc1test,vividas,vivo,vmd,vvc,"
    "wc3movie,wsvqa,wtv,xmv,yop,yuv4mpegpipe,alias_pix,brender_pix,bmp_pipe,cri_pipe,dds_pipe,dpx_pipe,"
    "exr_pipe,gem_pipe,gif_pipe,hdr_pipe,j2k_pipe,jpeg_pipe,jpegls_pipe,jpegxl_pipe,jpegxs_pipe,pam_pipe,"
    "pbm_pipe,pcx_pipe,pfm_pipe,pgm_pipe,pgmyuv_pipe,pgx_pipe,phm_pipe,photocd_pipe,pictor_pipe,png_pipe,"
    "ppm_pipe,psd_pipe,qdraw_pipe,qoi_pipe,sgi_pipe,sunrast_pipe,tiff_pipe,vbn_pipe,webp_anim,webp_pipe,"
    "xbm_pipe,xpm_pipe,xwd_pipe,aac,ac3,aiff,amr,ape,au,caf,dts,eac3,flac,mp3,tta,w64,wav,wv"
)


def open_file(
    medium: Medium, path: Path, options: Mapping[str, str] | None = None, hwaccel: HWAccel | None = None
) -> InputContainer:
    """Open one regular file of a medium. Raises InputError and FFmpeg's errors."""
    _refuse_heif(path, file := medium.file(path))
    formats = FORMATS if path.name.lower().endswith(".y") else f"{FORMATS},{_PICTURES}"
    return _open(f"file:{file}", formats, {"pattern_type": "none", **(options or {})}, hwaccel=hwaccel)


def _refuse_heif(path: Path, file: Path) -> None:
    """Raise InputError for a picture of HEIF, which FFmpeg would show as one of its tiles. FFmpeg reads AVIF."""
    with file.open("rb") as opened:
        head = opened.read(64)
    if head[4:8] == b"ftyp" and head[8:12] in HEIF and b"avif" not in head:
        raise InputError(f"{path}: {not_read(path)}")


def open_sequence(medium: Medium, pattern: Path, options: Mapping[str, str]) -> InputContainer:
    """Open numbered pictures. The caller has checked each of them with Medium.file."""
    if pattern.name.lower().endswith(".y"):
        raise InputError(f"{pattern}: planes in files of their own are not read; convert it to PNG")
    folder = str(medium.inside(pattern.parent)).replace("%", "%%")  # FFmpeg looks for the number in the whole path
    address = f"file:{folder}/{pattern.name}"
    return _open(address, _PICTURES, {"pattern_type": "sequence", **options}, format=_PICTURES)


def open_live(live: LiveAddress, options: Mapping[str, str]) -> InputContainer:
    """Open a camera, a filter graph or a stream."""
    formats = f"{FORMATS},{_STREAMS}" if live.format is None else live.format
    return _open(live.address, formats, options, live.protocols, live.format, (OPEN_S, READ_S))


def first_picture_s(container: InputContainer) -> float:
    """Return the time stamp of the first picture, in seconds. The player's times count from it."""
    video = container.streams.best("video")
    if video is None or video.start_time is None or video.time_base is None:
        return 0.0
    return float(video.start_time * video.time_base)


def reason(error: BaseException) -> str:
    """Return FFmpeg's error text in one line, without the path and the errno."""
    if isinstance(error, av.ArgumentError):
        return "a list of other media, or of a kind that is not read"
    if isinstance(error, av.ExitError):  # FFmpeg says "Immediate exit requested" after a timeout
        return "no answer in time"
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split()).rstrip(".")


def _open(
    address: str,
    formats: str,
    options: Mapping[str, str],
    protocols: str = "file",
    format: str | None = None,
    timeout: tuple[float, float] | None = None,
    hwaccel: HWAccel | None = None,
) -> InputContainer:
    whitelists = {"protocol_whitelist": protocols, "format_whitelist": formats}
    return av.open(
        address,
        format=format,
        options={**options, **whitelists},
        timeout=timeout,
        metadata_errors="replace",
        hwaccel=hwaccel,
    )


def log_natively(level: int) -> None:
    """Print messages from an av.logging level on to stderr. Call this in every process that codes or decodes.

    PyAV's log callback takes the GIL. A codec thread that logs while the main thread frees the codec then hangs the
    process, in half of the runs on a damaged H.264 file. FFmpeg's callback needs no GIL.
    """
    av.logging.restore_default_callback()
    av.logging.set_libav_level(level)
