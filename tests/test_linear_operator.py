"""T as a scipy LinearOperator: linear algebra, pixel order, pictures, scipy's solvers, and T as one sparse matrix."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh, lsmr, lsqr, svds

import counterlight as cl
from counterlight import memory
from counterlight.errors import InputError
from counterlight.maps.row_map import SparseRows
from counterlight.tools.linear_operator import TransportOperator
from counterlight.tools.transport.transport import BlurredLight, Dense, FarLight, Transport, stacked
from tests.blurred_rooms import calibrated
from tests.programs import ROOT

CAMERA, PROJECTOR = (7, 9), (5, 6)
CELLS = 4
FLOAT32 = 1e-5  # rounding of entries that are written out as float32


def random_rows(rng: np.random.Generator, rows: int, columns: int) -> SparseRows:
    return stacked([sparse.random_array((rows, columns), density=0.3, rng=rng, format="csr") for _ in range(3)])


def dense(rows: SparseRows) -> np.ndarray:
    """Returns (3, rows, columns)."""
    found = np.zeros((3, *rows.shape))
    for row, (start, end) in enumerate(zip(rows.indptr[:-1], rows.indptr[1:], strict=True)):
        found[:, row, rows.indices[start:end]] = rows.weights[start:end].T
    return found


@pytest.fixture(params=["near", "blurred", "far", "all"])
def parts(request: pytest.FixtureRequest) -> Transport:
    rng = np.random.default_rng(11)
    m, n = np.prod(CAMERA), np.prod(PROJECTOR)
    near, U, D, B, P = (
        random_rows(rng, *shape) for shape in ((m, n), (m, CELLS), (CELLS, n), (m, 2 * CELLS), (2 * CELLS, n))
    )
    far = FarLight(D, Dense(rng.random((3, CELLS, CELLS))), U) if request.param in ("far", "all") else None
    blurred = BlurredLight(P, None, B) if request.param in ("blurred", "all") else None
    return Transport(near, far, CAMERA, PROJECTOR, blurred)


@pytest.fixture
def matrices(parts: Transport) -> np.ndarray:
    """T by the formula S + B P + U M D, (3, camera pixels, projector pixels)."""
    found = dense(parts.near)
    if parts.blurred is not None:
        found = found + dense(parts.blurred.scatter) @ dense(parts.blurred.gather)
    if parts.far is not None:
        found = found + dense(parts.far.scatter) @ parts.far.mix.matrices @ dense(parts.far.gather)
    return found


def test_every_operator_is_its_matrix_and_has_the_transpose_as_adjoint(parts: Transport, matrices: np.ndarray) -> None:
    rng = np.random.default_rng(12)
    whole = np.einsum("kij,kl->ikjl", matrices, np.eye(3)).reshape(3 * matrices.shape[1], -1)
    T = TransportOperator(parts)
    for A, expected in ((T, whole), *((T.channel(k), matrices[k]) for k in range(3))):
        assert isinstance(A, LinearOperator)
        assert A.shape == expected.shape
        for B, matrix in ((A, expected), (A.T, expected.T), (A.H, expected.T), (A.T.T, expected)):
            x = rng.normal(size=(B.shape[1], 3))
            np.testing.assert_allclose(B @ x[:, 0], matrix @ x[:, 0], rtol=1e-10, atol=1e-12)  # float64 sums
            np.testing.assert_allclose(B @ x, matrix @ x, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(B.rmatmat(B @ x), matrix.T @ (matrix @ x), rtol=1e-10, atol=1e-10)
        u, v = rng.normal(size=A.shape[1]), rng.normal(size=A.shape[0])
        assert v @ (A @ u) == pytest.approx((A.T @ v) @ u, rel=1e-12)
        csr = A.to_csr()
        assert csr.has_canonical_format or csr.has_sorted_indices
        np.testing.assert_allclose(csr.toarray(), expected, rtol=FLOAT32, atol=1e-7)
        np.testing.assert_allclose(A.T.to_csr().toarray(), expected.T, rtol=FLOAT32, atol=1e-7)


def test_pictures_are_vectors_in_their_own_order(parts: Transport, matrices: np.ndarray) -> None:
    rng, T = np.random.default_rng(13), TransportOperator(parts)
    p, c = rng.random((*PROJECTOR, 3)), rng.random((*CAMERA, 3))
    for A, source, target in ((T, p, c), (T.T, c, p), (T.channel(1), p[..., 1], c[..., 1])):
        seen = A @ source
        assert seen.shape == target.shape
        np.testing.assert_array_equal(seen.ravel(), A @ source.ravel())
        np.testing.assert_array_equal(A(source), seen)
        for of in ("<f2", "<f4", ">f4", ">f8", "g", "?"):
            given = source.astype(of)
            np.testing.assert_array_equal(A @ given, A @ given.astype(np.float64))
    for k in range(3):
        np.testing.assert_allclose((T @ p)[..., k], T.channel(k) @ p[..., k], rtol=1e-12)
    np.testing.assert_allclose((T @ p)[2, 3, 1], matrices[1, 2 * 9 + 3] @ p[..., 1].ravel(), rtol=1e-12)
    gram = T.T @ T  # a product of operators
    np.testing.assert_allclose(gram @ p.ravel(), (T.T @ (T @ p)).ravel(), rtol=1e-12)
    np.testing.assert_allclose((2 * T) @ p.ravel(), 2 * (T @ p).ravel(), rtol=1e-12)


def test_a_channel_one_pixel_wide_takes_columns_as_scipy_does() -> None:
    tall = Transport.from_matrices([sparse.eye_array(4, format="csr")] * 3, camera=(4, 1), projector=(4, 1))
    x = np.arange(4.0)[:, None]
    np.testing.assert_array_equal(TransportOperator(tall).channel(0) @ x, x)


def test_scipys_solvers_work_with_it(parts: Transport) -> None:
    T = TransportOperator(parts)
    matrix = T.to_csr().toarray().astype(np.float64)
    b = T @ np.random.default_rng(14).random(T.shape[1])
    for solver in (lsqr, lsmr):
        tight = {"atol": 1e-12, "btol": 1e-12}
        p = solver(T, b, **tight)[0]
        np.testing.assert_allclose(T @ p, b, atol=1e-6 * np.abs(b).max())
    expected = np.linalg.svd(matrix, compute_uv=False)[:3]
    np.testing.assert_allclose(np.sort(svds(T, 3, return_singular_vectors=False))[::-1], expected, rtol=FLOAT32)
    np.testing.assert_allclose(np.sort(eigsh(T.T @ T, 3)[0])[::-1], expected**2, rtol=FLOAT32)
    green = T.channel(1)
    first = np.linalg.svd(matrix[1::3, 1::3], compute_uv=False)[0]
    assert svds(green, 1, return_singular_vectors=False)[0] == pytest.approx(first, rel=FLOAT32)


@pytest.mark.parametrize(
    ("light", "complaint"),
    [
        (np.ones((6, 5, 3)), r"shape \(6, 5, 3\), expected \(5, 6, 3\); width and height are swapped"),
        (np.ones((30, 3)), r"shape \(30, 3\), expected \(5, 6, 3\); or a flattened picture \(90,\)"),
        (np.ones(89), r"shape \(89,\), expected"),
        (np.ones((5, 6)), r"shape \(5, 6\), expected"),
        (np.ones((5, 6, 3), int), "light as int64, expected linear light in floating point"),
        (np.ma.masked_less(np.ones((5, 6, 3)), 0), "light: a masked array"),
    ],
)
def test_other_light_is_refused(parts: Transport, light: np.ndarray, complaint: str) -> None:
    with pytest.raises((InputError, TypeError), match=complaint):
        TransportOperator(parts) @ light


def test_a_folder_is_read_without_counterlight(
    parts: Transport, matrices: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lines of docs/files.md use only numpy."""
    monkeypatch.chdir(tmp_path)
    cl.Room(calibrated(parts), parts).write("room")
    block = re.search(r"```python\n(.*?)```", (ROOT / "docs" / "files.md").read_text(), re.DOTALL)
    assert block
    assert "counterlight" not in block[1]
    names: dict[str, object] = {}
    exec(compile(block[1], "docs/files.md", "exec"), names)
    expected = matrices[1] @ np.full(matrices.shape[2], 0.5)
    np.testing.assert_allclose(names["c"], expected.reshape(CAMERA), rtol=FLOAT32)


def test_wrong_channels_and_sizes_are_refused(parts: Transport) -> None:
    for k, complaint in ((3, "channel=3: expected 0 to 2"), (-1, "channel=-1"), ("red", "channel=.*a whole number")):
        with pytest.raises((InputError, TypeError), match=complaint):
            TransportOperator(parts).channel(k)
    with pytest.raises(InputError, match="T of unknown picture sizes"):
        TransportOperator(replace(parts, camera=None))


def test_a_matrix_that_does_not_fit_is_refused_with_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    T = cl.simulate("corner", camera=(24, 32), projector=(18, 24)).transport
    assert T.parts.far is not None
    monkeypatch.setattr(memory, "available_bytes", lambda: 1 << 20)
    for A in (T, T.channel(0)):
        with pytest.raises(InputError, match=r"T of 768x432 pixels .* 0\.332 million entries .* GiB .*pass T itself"):
            A.to_csr()
