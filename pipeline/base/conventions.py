"""The conventions of the whole project, said once.

Space
    World is right-handed, metres, y up. Cameras follow OpenCV: x right, y down, z forward,
    ``x_cam = R @ x_world + t``. Transforms are named ``a_from_b``. Quaternions are (w, x, y, z).
Pixels
    The top-left corner of an image is (0, 0): the centre of the first pixel is (0.5, 0.5). Intrinsics at
    an image d times smaller than the sensor are the sensor's divided by d, exactly. OpenCV counts from pixel
    centres: shift by ``PIXEL_CENTER`` where it is called.
Texels
    Atlas arrays are indexed [row, column], row 0 at the top. Texel (row, column) has its centre at
    u = (column + 0.5) / size, v = (row + 0.5) / size: the glTF convention, v pointing down.
Colour
    Images are linear RGB, Rec. 709 primaries, until the moment they are shown or scored; then sRGB.
Light
    Near field: an LED of radiant intensity I gives irradiance I / d^2 at distance d, before any cosine.
Precision
    float32 for images, Gaussians and networks; float64 for calibration, tracking and reference twins.
"""

PIXEL_CENTER = 0.5
"""Offset between this project's pixel coordinates and OpenCV's: ours = OpenCV's + 0.5."""
