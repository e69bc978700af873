"""What all specimens have in common."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class SpecimenPart(BaseModel):
    """Common behaviour of every specimen: unchangeable, and no field that we do not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")
