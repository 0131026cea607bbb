"""What a recording for the rerun viewer has in it."""

import pytest


def columns_of(path):
    """Values of each (entity, column) of a recording."""
    reader = pytest.importorskip("rerun.chunk", reason="needs a rerun-sdk that reads recordings, too").RrdReader(path)
    columns = {}
    for chunk in (chunk.to_record_batch() for chunk in reader.stream().to_chunks()):
        entity = (chunk.schema.metadata or {}).get(b"rerun:entity_path", b"?").decode()
        for name in chunk.schema.names:
            columns.setdefault((entity, name), []).extend(chunk[name].to_pylist())
    return columns
