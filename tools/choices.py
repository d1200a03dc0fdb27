"""The names that options take, without their meaning, so that help and completion need no library."""

COLOURS = ("auto", "independent", "global", "pixel")  # tools/colour/tiers.py
SCREENS = ("camera", "projector")  # tools/joining/shared_screen.py
OUTSIDE = ("black", "continue")  # tools/transport/objective.py
INVERSES = ("auto", "whole", "cut", "none", "thesis")  # tools/inverse/near_light.py
SCHEMES = ("hierarchical", "multiplexed", "graycode")  # tools/acquire_transport.py
GRAYCODE_ORDERS = ("opencv", "sltk")  # tools/acquisition/captures.py
COMPENSATIONS = ("none", "direct", "triangulated", "map", "qr", "svd", "nnls", "box")  # tools/solve/compensate.py
VERIFIED = ("box", "map")  # tools/acquisition/verify.py
RELIT_VIEWS = ("camera", "dual", "inverse-camera", "inverse-dual")  # tools/relighting/relight.py
MERGES = ("debevec", "robertson", "average")  # tools/hdr/estimators.py
WEIGHTINGS = ("hat", "gaussian")  # tools/hdr/estimators.py
STUDIED_PICTURES = ("photograph", "text", "gradient", "white", "dark-film", "film")  # tools/study/pictures.py
USUAL_PICTURES = STUDIED_PICTURES[:5]
MOST_LAG = 20  # frames, tools/acquisition/cameras/simulated.py
TOLERANCE, MOST_TOLERANCE = 0.1, 10.0  # dB, tools/factoring/factoring.py
BLUR_TOLERANCE = 0.2  # dB, tools/blurring/blurring.py
