"""The child processes that decode, and the parent's end of them: media in, planes of samples with their time out.

source.py is what every kind of medium offers; media.py chooses by name, pixels.py turns FFmpeg's pictures into planes.
decoder.py, audio_decoder.py and sound_copier.py are the processes; decoder_link.py starts, hears and ends them,
ffmpeg_log.py keeps their messages out of Python.
Used through player/media/video.py, audio.py and sound_track.py. Read next: source.py, decoder.py.
"""
