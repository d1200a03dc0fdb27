"""Child processes that decode media into planes of samples with times, and the parent's connection to them.

source.py defines what every kind of medium offers. media.py chooses the source by name, and pixels.py converts FFmpeg's
pictures into planes. decoder.py, audio_decoder.py and sound_copier.py are the processes. decoder_link.py starts them,
receives their events and ends them. opening.py opens files, and prints FFmpeg's messages without Python.

Used by player/media/video.py, audio.py and sound_track.py. Read next: source.py, decoder.py.
"""
