# Texts of light.js.
light-title = Licht und Schärfe
light-what = Kanten scharf, nichts übersteuert: zuerst das Licht, dann die Ringe der Objektive, und sehen Sie dabei, was es kostet.
light-thing = Legen Sie zuerst eine Tafel oder ein Teil dorthin, wo Teile liegen werden: danach werden Licht und Schärfe beurteilt, und eine leere Szene gäbe falschen Rat.
light-thing-is = Es liegt da
light-thing-there = Licht und Schärfe werden nach dem beurteilt, was da liegt.
light-thing-gone = Es liegt nichts mehr da
light-take = Nehmen Sie die Zelle, um Belichtung und Verstärkung einzustellen: ihre Kameras werden gebraucht.
light-no-settings = Hier lässt sich nichts einstellen: die Kamera nennt keine Grenzen oder ist nicht da.
light-no-figures = Zahlen kommen mit den Live-Bildern.
settings-left = Einstellungen der linken Kamera
settings-right = Einstellungen der rechten Kamera
setting-exposure-us = Belichtung
setting-gain-db = Verstärkung
light-head = Licht
light-figures = { $clipped } % übersteuert, { $dark } % zu dunkel, Rauschen { $noise } und Kontrast { $contrast } Grauwerte
advice-good = Die Belichtung ist gut.
advice-less-light = Etwas ist übersteuert: weniger Belichtung oder weniger Licht. Dort lässt sich nichts messen.
advice-more-light = Zu dunkel: länger belichten, oder mehr Licht.
advice-light-for-gain = Verrauscht: weniger Verstärkung, dafür länger belichten oder mehr Licht.
advice-take = { $exposure } µs einstellen
legend-clipped = übersteuert
legend-dark = zu dunkel
light-copy = Rechte Kamera genauso einstellen
focus-title = Schärfe
focus-none = Keine Kanten zu beurteilen: legen Sie eine Tafel oder ein Teil hin.
focus-now = Kanten sind { $now } px breit
focus-best = bestes { $best } px
focus-cost =
    { $isFree ->
        [0] Das kostet nichts an Sigma Z.
       *[other] Das kostet +{ $percent } % an Sigma Z.
    }
focus-reset = Bestes vergessen
