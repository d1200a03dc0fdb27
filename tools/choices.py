"""The names that options take, without their meaning, so that help and completion need no library."""

COLOURS = ("auto", "independent", "global", "pixel")  # the tiers of tools/colour/tiers.py
SCREENS = ("camera", "projector")  # the screens of tools/joining/shared_screen.py
OUTSIDE = ("black", "dark", "continue")  # the treatments of tools/transport/objective.py
INVERSES = ("auto", "whole", "cut", "none", "thesis")  # the inverses of tools/inverse/near_light.py
SCHEMES = ("hierarchical", "multiplexed", "graycode")  # the schemes of tools/acquire_transport.py
GRAYCODE_ORDERS = ("opencv", "sltk")  # the orders of tools/acquisition/captures.py
# the solvers of tools/solve/compensate.py
COMPENSATIONS = ("none", "direct", "triangulated", "map", "qr", "svd", "nnls", "box")
VERIFIED = ("box", "map")  # the solvers of tools/acquisition/verify.py
RELIT_VIEWS = ("camera", "dual", "inverse-camera", "inverse-dual")  # the views of tools/relighting/relight.py
MERGES = ("debevec", "robertson", "average")  # the methods of tools/hdr/estimators.py
WEIGHTINGS = ("hat", "gaussian")  # the weightings of tools/hdr/estimators.py
# the pictures of tools/study/pictures.py
STUDIED_PICTURES = ("photograph", "text", "gradient", "white", "dark-film", "film")
USUAL_PICTURES = STUDIED_PICTURES[:5]
MOST_LAG = 20  # in frames, for tools/acquisition/cameras/simulated.py
TOLERANCE, MOST_TOLERANCE = 0.1, 10.0  # in dB, for tools/factoring/factoring.py
BLUR_TOLERANCE = 0.2  # in dB, for tools/blurring/blurring.py
