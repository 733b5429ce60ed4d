# Texte der Seite, die einen Auftrag ausprobiert.

try-title = Probieren
try-what = Schieben Sie das Teil umher, wie es in der Produktion liegen wird. Jedes Live-Paar wird gemessen, und nichts davon geht an die SPS.
try-no-rig = Es gibt noch keine Kalibrierung: ohne sie lässt sich nichts messen.
try-nothing = Es gibt noch nichts auszuprobieren: lernen Sie zuerst ein Teil ein.
try-which = Was ausprobiert wird
try-drafts = Entwürfe
try-jobs = Aufträge dieser Zelle
try-start = Live ausprobieren
try-stop = Anhalten
try-take = Nehmen Sie die Zelle, um auszuprobieren: ihre Kameras werden gebraucht.
try-off = Es wird nicht ausprobiert.
try-coming = Das erste Ergebnis kommt gleich.
try-status-ok = Gut
try-status-no-target = Kein Teil gefunden
try-status-low-quality = Nicht gut
try-why-few-edges = Es ist nicht genug davon zu sehen: liegt etwas darüber, glänzt es, oder ragt es aus einem Bild?
try-why-residual = Seine Kanten streuen zu sehr: ist es schmutzig, unscharf oder ein anderes Teil?
try-why-sigma-limit = Sein Ort ist nicht genau genug bekannt: siehe die Karte.
try-why-left-right-mismatch = Die Kameras widersprechen sich: hat es sich bewegt, oder wurde eine Kamera gestoßen?
try-why-out-of-volume = Es ist näher oder ferner, als der Auftrag erlaubt.
try-why-tolerance = Ein Maß ist nicht wie eingelernt: ist es ein anderes Teil?
try-why-ambiguous-rotation = Es lässt sich nicht sagen, wie herum es liegt.
try-why-low-score = Zu wenig davon sieht aus wie eingelernt.
try-why-calibration = Die Kalibrierung ist gewandert: prüfen Sie sie.
try-why-ambiguous-edge = Der Bezug kann auf einer anderen Kante liegen, etwa einer Fase.
try-why-out-of-limits = Es liegt, wohin der Roboter nicht darf.
try-why-keep-out = Es liegt, wohin der Roboter nicht darf.
try-why-no-grasp = Kein Griff des Auftrags liegt, wo der Roboter hinkommt.
try-why-not-found = Ist das Teil in beiden Bildern, und etwa so weit weg wie beim Einlernen?
try-frame-robot = Im System des Roboters
try-frame-rig = Im System der Kameras: kein Roboter ist eingemessen
try-measured = Jetzt gemessen
try-whiskers = Die dünnen Striche in den Bildern sagen, wie weit jede Kante neben ihrer Kurve liegt, vergrößert wie ihr Maßstab.
try-still = Ist das Sigma ehrlich?
try-still-what = Jetzt darf sich nichts bewegen, weder Teil noch Kameras noch Licht. Die Streuung der Ergebnisse wird mit dem verglichen, was edged zu jedem sagt.
try-still-start = Stillhalten, { $count } Bilder
try-still-running = Es wird gemessen …
try-still-failed = Es ließ sich nicht sagen:
try-verdict-honest = Das Sigma ist hier ehrlich: { $chi2 }, erwartet { $low } bis { $high }.
try-verdict-larger = Die Ergebnisse streuen mehr, als ihr Sigma sagt: { $chi2 }, erwartet { $low } bis { $high }. Bewegt sich etwas, oder flackert das Licht?
try-verdict-smaller = Die Ergebnisse streuen weniger, als ihr Sigma sagt: { $chi2 }, erwartet { $low } bis { $high }. Das Sigma ist hier auf der sicheren Seite.
try-verdict-moving = In diesen { $count } Bildern hat sich etwas bewegt: halten Sie still und versuchen Sie es noch einmal.
try-verdict-vanished = In einigen dieser { $count } Bilder war das Teil weg: legen Sie es hin und versuchen Sie es noch einmal.
try-axis = Achse
try-scatter = Streuung
try-edges = Sigma der Kanten
try-map-title = Was wo zu erwarten ist
try-map-what = Das Schlechteste von X, Y, Z in µm, von den Kameras gesehen, für die Merkmale dieses Auftrags bei diesem Licht.
try-map-usual = Das Schlechteste von X, Y, Z in µm, von den Kameras gesehen, für die Merkmale dieses Auftrags bei üblichem Licht: sobald ein Teil gemessen ist, bei diesem.
try-map-coming = Die Karte wird gemacht …
try-map-none = Nirgends sehen beide Kameras genug von diesem Teil.
try-map-beyond =
    { $beyond ->
        [0] Überall innerhalb der Grenze von { $limit } µm.
       *[other] An { $beyond } von { $count } Orten ist die Grenze von { $limit } µm überschritten.
    }
try-map-layer = Wie weit weg
try-layer-near = nah
try-layer-middle = Mitte
try-layer-far = fern
try-legend-within = innerhalb der Grenze
try-legend-beyond = darüber
try-legend-covered = hier war ein Teil gut
try-covered = { $percent } % des Raums sind bewiesen
