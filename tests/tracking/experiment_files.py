"""An experiment file of a recording with other keys."""

import json

import tomli_w

from plenopiv.experiment import Experiment


def with_keys(folder, name, output, **tables):
    """The path of an experiment file in the recording's folder with other keys."""
    content = Experiment.load(folder / "experiment.toml").model_dump(by_alias=True, exclude_none=True)
    content["output"]["directory"] = str(output)
    for table, keys in tables.items():
        content[table] = content.get(table, {}) | keys
    (folder / name).write_text(tomli_w.dumps(json.loads(json.dumps(content))))
    return folder / name
