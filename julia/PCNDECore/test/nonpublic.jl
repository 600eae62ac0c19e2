"""
Names of other packages that PCNDECore uses although they are not public, with the versions
for which the tests passed. A version outside this list may rename or change them.

| package            | names                                          | tested        |
|:-------------------|:-----------------------------------------------|:--------------|
| OrdinaryDiffEqCore | controller interface, see `step_control.jl`    | 4.6–4.15      |
"""
const NONPUBLIC = ()
